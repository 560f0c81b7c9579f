"""clt: collaborative localization from range and odometry logs.

`clt.load`, `simulate`, `localize`, `evaluate`, `data_frames` and `score_frame` are there for
scripts and notebooks; each is imported when it is first used.
"""

from __future__ import annotations

__version__ = "0.1.0"

_PLACES = {
    "Localization": "clt.api",
    "data_frames": "clt.tables",
    "evaluate": "clt.api",
    "load": "clt.api",
    "localize": "clt.api",
    "score_frame": "clt.tables",
    "simulate": "clt.api",
}
"""The module of every public name; their types stand in `__init__.pyi`."""


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module 'clt' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - instant without

    found: object = getattr(import_module(_PLACES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACES})
