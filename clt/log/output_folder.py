"""Several files into one folder: all of them take their names, or none does."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from clt.core.errors import CltError
from clt.log.output import STDOUT, check_output, open_output


def check_folder(
    folder: Path, names: Sequence[str], force: bool = False, inputs: Sequence[Path] = ()
) -> None:
    """Raise CltError unless the files may be written: the folder may exist, the files not."""
    if folder == STDOUT:
        raise CltError("-: several files cannot go to standard output; name a folder")
    if folder.exists() and not folder.is_dir():
        raise CltError(f"{folder}: is a file; name a folder")
    if not folder.is_dir():
        if not folder.parent.is_dir():
            raise CltError(f"{folder}: no directory {folder.parent}; create it first")
        return
    for name in names:
        check_output(folder / name, force, inputs)


def write_folder(
    folder: Path,
    files: Mapping[str, Callable[[], bytes]],
    force: bool = False,
    inputs: Sequence[Path] = (),
) -> None:
    """Write the files by name; none appears before all are whole, others in the folder stay.

    Raises CltError as `check_folder` does, and where a file cannot be written.
    """
    check_folder(folder, list(files), force, inputs)
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        with ExitStack() as stack:
            for name, content in files.items():
                file = stack.enter_context(open_output(folder / name, force, inputs))
                file.write(content())
    except BaseException:
        if made:
            with suppress(OSError):  # not empty: somebody else wrote into it
                folder.rmdir()
        raise
