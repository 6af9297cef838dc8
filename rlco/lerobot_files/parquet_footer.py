"""What a parquet file declares of its columns, read from its footer.

pyarrow tells the same, but ends the whole process over some damaged footers: an
exception that its Python does not catch. Reading rows through it raises as it should.
The footer is Thrift's compact protocol,
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md, its
fields those of https://github.com/apache/parquet-format.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Bytes of a value in memory by its physical type's number; of the others, texts and
#: images, the file says how many they are.
_WIDTH = {0: 1, 1: 4, 2: 8, 3: 12, 4: 4, 5: 8}
_DEEPEST = 32
_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = (
    *(1, 2, 3, 7, 8, 9, 10, 11, 12),
)


@dataclass(frozen=True)
class Leaf:
    """A column of a row group.

    Attributes:
        path: Its place in the schema, ``action.list.element``.
        column: The column that it belongs to, ``action``.
        declared: Bytes that its values take in memory.
        plain: Whether they are plain numbers.
        values: Their number.
        rows: That of the row group's rows.
    """

    path: str
    column: str
    declared: int
    plain: bool
    values: int
    rows: int


def leaves(file: Path) -> Iterator[Leaf]:
    """Yield the columns of every row group of a parquet file.

    Raises:
        ValueError: Its footer is damaged; also as ``IndexError`` and other built-in
            exceptions, which `rlco.files.reading` knows.
    """
    with file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - 8, 0))
        length = int.from_bytes(stream.read(4), "little")
        if length > size - 12:
            raise ValueError(f"a footer of {length} bytes in a file of {size}")
        stream.seek(size - 8 - length)
        metadata = _Compact(stream.read(length)).struct(0)
    for group in metadata[4]:
        for chunk in group[1]:
            column = chunk[3]
            width = _WIDTH.get(column[1])
            names = [name.decode() for name in column[3]]
            values = column[5]
            declared = column[6] if width is None else width * values
            plain, path = width is not None, ".".join(names)
            yield Leaf(path, names[0], declared, plain, values, group[3])


class _Compact:
    """Reads values of Thrift's compact protocol: structs as dicts by field number."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0

    def struct(self, depth: int) -> dict[int, Any]:
        """Return the fields of a struct."""
        if depth > _DEEPEST:
            raise ValueError("structs in structs without end")
        fields: dict[int, Any] = {}
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            fields[number] = kind == _TRUE if kind <= _FALSE else self._of(kind, depth)
        return fields

    def _of(self, kind: int, depth: int) -> Any:
        if kind == _BYTE or kind <= _FALSE:
            return self._byte()
        if kind < _DOUBLE:
            return self._integer()
        if kind == _DOUBLE:
            return struct.unpack("<d", self._take(8))[0]
        if kind == _BINARY:
            return self._take(self._varint())
        if kind in (_LIST, _SET):
            head = self._byte()
            count = head >> 4 if head >> 4 < 15 else self._varint()
            return [
                self._of(head & 15, depth + 1) for _ in range(self._possible(count))
            ]
        if kind == _MAP:
            count = self._possible(self._varint())
            head = self._byte() if count else 0
            kinds = (head >> 4, head & 15) * count
            return [self._of(one, depth + 1) for one in kinds]
        if kind == _STRUCT:
            return self.struct(depth + 1)
        raise ValueError(f"no type {kind}")

    def _possible(self, count: int) -> int:
        """Return a number of items, each of which takes a byte or more."""
        if count > len(self._content) - self._at:
            raise ValueError(f"{count} items in fewer bytes")
        return count

    def _take(self, count: int) -> bytes:
        found = self._content[self._at : self._at + self._possible(count)]
        self._at += count
        return found

    def _byte(self) -> int:
        self._at += 1
        return self._content[self._at - 1]

    def _varint(self) -> int:
        value = shift = 0
        while (byte := self._byte()) & 128:
            value |= (byte & 127) << shift
            shift += 7
            if shift > 63:
                raise ValueError("a number of more than 64 bits")
        return value | byte << shift

    def _integer(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)
