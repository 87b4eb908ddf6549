"""``run.jsonl``: a line for each item of each run, appended so that a kill can tear the last line only."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

import msgspec

from clgrid.batch.item import ItemRecord
from clgrid.errors import ClgridError, InputError

_PATIENCE_SECONDS = 20.0


class Ledger:
    """The records of a job or of one shard of it, locked against other runs.

    The lock is shared with the child process, so that a new run waits for the child of a killed one.

    Raises
    ------
    ClgridError
        If the file cannot be written, or another run goes on.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}); name other records") from error
        try:
            _lock(self._file, path)
            self.torn = _cut_torn_line(self._file)
        except BaseException:
            os.close(self._file)
            raise

    @property
    def descriptor(self) -> int:
        """For the child to hold."""
        return self._file

    def append(self, record: ItemRecord) -> None:
        """Add a line.

        Raises
        ------
        ClgridError
            If the disk is full; the file then ends with the line before.
        """
        line = msgspec.json.encode(record) + b"\n"
        before = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line) == len(line):
                return
            reason = "disk full"
        except OSError as error:
            reason = error.strerror or str(error)
        with contextlib.suppress(OSError):
            os.ftruncate(self._file, before)
        raise ClgridError(f"{self.path}: a record cannot be written ({reason}); make room and run again")

    def close(self) -> None:
        """Let others have it."""
        os.close(self._file)


def read_records(path: Path) -> list[ItemRecord]:
    """Every whole record of a file, in its order; a torn last line is passed over.

    Raises
    ------
    InputError
        If the file cannot be read, or a whole line is no record.
    """
    try:
        lines = path.read_bytes().split(b"\n")[:-1]
        return [msgspec.json.decode(line, type=ItemRecord) for line in lines if line]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except msgspec.MsgspecError as error:
        raise InputError(f"{path}: holds a line that is no record ({error})") from error


def _lock(file: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: runs at the same time are the user's to avoid
        return
    begun = time.monotonic()
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() - begun > _PATIENCE_SECONDS:
                raise InputError(
                    f"{path}: another run of this job goes on; wait for it, or give each a --shard of its own"
                ) from None
            time.sleep(0.05)


def _cut_torn_line(file: int) -> bool:
    """Drop what follows the last newline; whether there was anything."""
    size = os.fstat(file).st_size
    end = size
    while end:
        first = max(0, end - (1 << 16))
        newline = os.pread(file, end - first, first).rfind(b"\n")
        if newline >= 0:
            end = first + newline + 1
            break
        end = first
    if end == size:
        return False
    os.ftruncate(file, end)
    return True
