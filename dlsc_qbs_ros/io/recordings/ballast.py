"""Room on the disk that is held to be given up when a write finds no other."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any, Callable

BALLAST_FILE = '.ballast'


class Ballast:
    """A file of nothing, as large as what the end of a recording may need; see `shortage`."""

    def __init__(self, directory: Path):
        self.shortage = ''  # why it was given up
        self._path = directory / BALLAST_FILE
        self._size_bytes = 0

    def hold(self, size_bytes: int) -> None:
        """Hold at least so much, unless it was given up; raise OSError where there is less."""
        if size_bytes <= self._size_bytes or self.shortage:
            return
        try:
            with open(self._path, 'ab') as stream:
                os.posix_fallocate(stream.fileno(), 0, size_bytes)
        except OSError as error:  # another refusal, as of a limit of size, is no lack of room
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                raise
        self._size_bytes = size_bytes

    def release(self) -> None:
        """Let go of it."""
        self._path.unlink(missing_ok=True)
        self._size_bytes = 0

    def insist(self, action: Callable[[], Any]) -> Any:
        """Do something on the disk; when that is refused, once more with the ballast gone."""
        try:
            return action()
        except OSError as error:
            if self.shortage or not self._size_bytes:
                raise
            self.release()
            self.shortage = error.strerror
            return action()
