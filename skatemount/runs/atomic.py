"""Files and folders that appear whole or not at all.

What is written goes to a temporary neighbour first, is flushed to the disk, and takes its final
name with one `os.replace`. A process killed at any moment leaves what was there before, and at most
a hidden temporary beside it, which `recover` clears.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

_TEMPORARY = ".tmp"
_DISPLACED = ".old"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a temporary file to write, which becomes `path` when the block ends without an error.

    Args:
        path: The file to make or replace; its folder is made if it is missing.

    Yields:
        The temporary path, in the same folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary_neighbour(path)
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync_folder(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Writes or replaces a file with `data` in one step."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Writes or replaces a file with `text` (UTF-8, line ends as given) in one step."""
    write_bytes(path, text.encode("utf-8"))


@contextlib.contextmanager
def replacing_folder(final: Path) -> Iterator[Path]:
    """Gives an empty folder to fill, which becomes `final` when the block ends without an error.

    Files written in the block are to be flushed by their writer (`write_bytes` does). An existing
    `final` stays until the new one is complete. One process at a time may write in a parent folder,
    because leftovers of earlier crashes found there are cleared first.

    Args:
        final: The folder to make or replace.

    Yields:
        The staging folder, beside `final`.
    """
    final.parent.mkdir(parents=True, exist_ok=True)
    recover(final.parent)
    staged = _temporary_neighbour(final)
    staged.mkdir()
    try:
        yield staged
        for folder, _, _ in os.walk(staged):
            _sync_folder(Path(folder))
        displaced = final.with_name(f".{final.name}{_DISPLACED}")
        if final.exists():
            # A folder cannot be replaced by one that has files. Between these two renames the old
            # one is only under its hidden name: `recover` gives it its name back.
            os.replace(final, displaced)
        os.replace(staged, final)
        _sync_folder(final.parent)
        shutil.rmtree(displaced, ignore_errors=True)
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Deletes a folder so that it is never seen half deleted under its own name."""
    doomed = _temporary_neighbour(folder)
    os.replace(folder, doomed)
    shutil.rmtree(doomed, ignore_errors=True)


def recover(parent: Path) -> None:
    """Clears what a crash left in `parent`, and restores a folder that was being replaced."""
    for displaced in parent.glob(f".*{_DISPLACED}"):
        final = parent / displaced.name.removeprefix(".").removesuffix(_DISPLACED)
        if final.exists():
            shutil.rmtree(displaced, ignore_errors=True)
        else:
            os.replace(displaced, final)
    for temporary in parent.glob(f".*{_TEMPORARY}"):
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)


def _temporary_neighbour(path: Path) -> Path:
    # Not `tempfile`: its files are private to the user whatever the umask says.
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{_TEMPORARY}")


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_folder(folder: Path) -> None:
    # Some file systems refuse this for folders; the rename itself is atomic all the same.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
