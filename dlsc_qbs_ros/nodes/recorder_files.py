"""What a recorder does about other files: it attaches some, and repairs earlier recordings."""

from __future__ import annotations

import logging
import mimetypes
from pathlib import Path
import threading
from typing import NamedTuple

from ..config import Config
from ..errors import RecordingError
from ..io.recordings.mcap_repair import Repair
from ..io.recordings.recovery import repair_earlier
from ..profiles import to_yaml

_log = logging.getLogger(__name__)


class Attachment(NamedTuple):
    """A file as it goes into a recording."""

    name: str
    media_type: str
    data: bytes


def attachments_of(config: Config) -> list[Attachment]:
    """
    Return the configuration of the run, and the files that it names.

    Raises
    ------
    RecordingError
        When one of them cannot be read.

    """
    attachments = [Attachment('config.yaml', 'application/yaml', to_yaml(config).encode())]
    for path in map(Path, config.recorder.attachments):
        media_type, _ = mimetypes.guess_type(path)
        try:
            attachments.append(Attachment(
                path.name, media_type or 'application/octet-stream', path.read_bytes()))
        except OSError as error:
            raise RecordingError(
                f'recorder.attachments: {path}: cannot be read: {error.strerror}') from error
    return attachments


class Repairs:
    """The repair of recordings that ended without an end, in a folder, by a thread of its own."""

    def __init__(self, folder: Path):
        self.n_repaired = self.n_failed = 0
        self._is_stopping = False
        self._thread = threading.Thread(target=self._run, args=(folder,), name='repairs')
        self._thread.start()

    def stop(self) -> None:
        """Leave what is not begun for the next time."""
        self._is_stopping = True
        self._thread.join()

    def _run(self, folder: Path) -> None:
        try:
            for repair in repair_earlier(folder):
                self._tell(repair)
                if self._is_stopping:
                    return
        except Exception:  # a thread would die of it in silence
            self.n_failed += 1
            _log.exception('%s: the repair of earlier recordings failed', folder)

    def _tell(self, repair: Repair) -> None:
        if repair.error:
            self.n_failed += 1
            _log.error('%s cannot be repaired: %s', repair.path, repair.error)
        else:
            self.n_repaired += 1
            _log.warning('%s had no end and was repaired: %d messages, %d bytes lost',
                         repair.path, repair.n_messages, repair.lost_bytes)
