"""The thread of a recording that syncs and tidies up, so that no message waits for it."""

from __future__ import annotations

import threading
import time

from .bag_writer import BagWriter
from ...errors import RecordingError

_TIDY_PERIOD_S = 5.0


class Keeper:
    """Keep a recording synced and its metadata true."""

    def __init__(self, bag: BagWriter, changed: threading.Event, sync_interval_s: float):
        self._unsynced = self._untidy = ''
        self._bag, self._changed, self._sync_interval_s = bag, changed, sync_interval_s
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name='recording_keeper', daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """Return what did not work; a failure to sync stays: what it lost is lost."""
        return self._unsynced or self._untidy

    def stop(self) -> None:
        """End the thread; `keep` may be called from the caller's own then."""
        self._stopping = True
        self._changed.set()
        self._thread.join()

    def keep(self, tidying: bool = True) -> None:
        """Sync what was written, if that is wished for, and bring the metadata up to date."""
        if self._sync_interval_s:
            try:
                self._bag.sync()
            except OSError as error:
                self._unsynced = f'{self._bag.directory}: cannot be synced: {error.strerror}'
        if tidying:
            try:
                self._bag.tidy()
                self._untidy = ''
            except RecordingError as error:
                self._untidy = str(error)

    def _run(self) -> None:
        try:
            self._keep_on()
        except Exception as error:  # a keeper that died must not look alive
            self._unsynced = f'{self._bag.directory}: the keeper failed: {error!r}'

    def _keep_on(self) -> None:
        period_s = min(self._sync_interval_s or _TIDY_PERIOD_S, _TIDY_PERIOD_S)
        due_s = 0.0
        while True:
            has_changed = self._changed.wait(period_s)
            self._changed.clear()
            if self._stopping:
                return
            tidying = has_changed or time.monotonic() >= due_s
            self.keep(tidying)
            if tidying:
                due_s = time.monotonic() + _TIDY_PERIOD_S
