"""Files that others wrote: read with their types checked, their sizes and places, too.

``reading(path)`` turns what a library raises over a damaged file into one sentence,
``Fields`` gives the entries of a mapping by their types, ``read_json`` and
``read_yaml`` use both. No torch here.
"""

from __future__ import annotations

from rlco.files.fields import Fields as Fields
from rlco.files.reading import few as few
from rlco.files.reading import reading as reading
from rlco.files.reading import shown as shown
from rlco.files.texts import read_json as read_json
from rlco.files.texts import read_json_lines as read_json_lines
from rlco.files.yaml_files import read_yaml as read_yaml
from rlco.files.yaml_files import yaml_text as yaml_text
