"""MATLAB 5 files: their variables, and one line for what is wrong with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import LogError
from clt.log.recording.cleaning import MAX_MEASUREMENT


def read_mat_file(path: Path, expected: str) -> dict[str, Any]:
    """The variables of a MATLAB 5 file by name, squeezed.

    Raises:
        LogError: for a file that cannot be read; `expected` is the name of the right one.
    """
    from scipy.io import loadmat  # noqa: PLC0415 - slow to import, and only wanted here

    try:
        content: dict[str, Any] = loadmat(str(path), appendmat=False, squeeze_me=True)
    except FileNotFoundError as error:
        raise LogError(f"{path}: {error.strerror}; give the folder that holds {expected}") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    except Exception:  # noqa: BLE001 - scipy lets through whatever a broken file provokes
        raise LogError(f"{path}: not a MATLAB 5 file, or a damaged one; {expected} is") from None
    return content


def mat_table(content: dict[str, Any], name: str, width: int, path: Path) -> Floats:
    """A variable as rows of `width` finite numbers, shape (n, width).

    Raises:
        LogError: naming the variable that is missing or is something else.
    """
    if name not in content:
        there = ", ".join(sorted(key for key in content if not key.startswith("__")))
        raise LogError(f"{path}: no `{name}` in it; it has: {there or 'nothing'}")
    try:
        table = np.atleast_2d(np.asarray(content[name], np.float64))
    except (TypeError, ValueError):
        raise LogError(f"{path}: `{name}` is not numeric") from None
    if table.ndim != 2 or table.shape[1] != width or len(table) == 0:
        raise LogError(f"{path}: `{name}` has the shape {table.shape}, not (rows, {width})")
    usable = (np.abs(table) <= MAX_MEASUREMENT).all(axis=1)  # false for NaN
    if not usable.all():
        row = int(np.argmin(usable)) + 1
        raise LogError(
            f"{path}: `{name}`, row {row}: a value is not finite, or beyond {MAX_MEASUREMENT:g}"
        )
    return table
