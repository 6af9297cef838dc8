"""Sphinx builds the documentation with this: ``sphinx-build -W docs docs/_build``."""

from __future__ import annotations

import re
from importlib.metadata import version as installed_version
from typing import Any

from sphinx.util import inspect

project = "rlco"
author = "the rlco authors"
release = version = installed_version("rlco")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",  # formulas are drawn without a network
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "example"]
html_theme = "furo"
html_static_path = ["gallery"]
html_title = "rlco"

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_attr_annotations = False

# Prompts and output stay out of what the button copies.
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def escape_shapes(_app: Any, _what: str, _name: str, *found: Any) -> None:
    """Keep the star of a shape such as [*B, H] from starting emphasis."""
    _, _, lines = found
    lines[:] = [re.sub(r"\*(?=B[,\]]|feature)", r"\\*", line) for line in lines]


def keep_colons(_app: Any, what: str, *found: Any) -> None:
    """Keep napoleon from taking what stands before a colon for a type.

    It does so in the first line about an attribute or a property. An escaped space
    becomes that line; it is drawn as nothing.
    """
    if what in ("attribute", "data", "property"):
        found[-1].insert(0, "\\ ")


def own_signature(
    _app: Any, what: str, _name: str, made: Any, _options: Any, *found: str | None
) -> tuple[str | None, ...]:
    """Show a constructor's arguments where TorchRL's metaclasses hide them.

    A protocol has none.
    """
    signature, returned = found
    if getattr(made, "_is_protocol", False):
        return "", None
    if what == "class" and signature == "(*args, **kwargs)":
        own = inspect.signature(made.__init__, bound_method=True)
        signature = inspect.stringify_signature(own, unqualified_typehints=True)
    return signature, returned


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", own_signature)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)
    app.connect("autodoc-process-docstring", escape_shapes)
