"""How the documentation is built: Sphinx, Markdown by MyST, the theme furo."""

from __future__ import annotations

from clt import __version__

project = "clt"
author = "The clt developers"
project_copyright = author
release = __version__
extensions = ["myst_parser"]
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"clt {__version__}"
html_copy_source = False
html_show_sphinx = False
