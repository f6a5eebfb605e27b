"""MAVLink 2 signatures: a key that only its owner can read, and time that never falls back."""

from __future__ import annotations

from hashlib import sha256
from hmac import compare_digest
import json
import os
from pathlib import Path
import stat
import time

from .framing import dialect, Packet
from ..disk import replacement
from ...errors import ConfigError

KEY_LENGTH = 32
PERSIST_PERIOD_S = 5.0
# Timestamps count 10 us from 2015 on; a stream not met before may lag a minute.
_TICKS_PER_S = 100_000
_EPOCH_2015_S = 1_420_070_400
_MAX_LAG = 60 * _TICKS_PER_S


def load_key(path: Path) -> bytes:
    """
    Return the key of 32 bytes: as it stands, of 64 hex digits, or the SHA-256 of a passphrase.

    Raises
    ------
    ConfigError
        When the file cannot be read, is empty, or may be read by others than its owner.

    """
    try:
        with open(path, 'rb') as file:
            mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
            content = file.read()
    except OSError as error:
        raise ConfigError(f'mavlink.key_file = {str(path)!r}: {error.strerror}') from error
    if mode & 0o077:
        raise ConfigError(f'mavlink.key_file = {str(path)!r}: mode {mode:04o}, expected one that '
                          'group and others cannot read, as 0600')
    # As bytes; but those of an editor, a line of 31 characters and its end, are a passphrase.
    if len(content) == KEY_LENGTH and not (content.isascii() and content.endswith(b'\n')):
        return content
    text = content.strip()
    if not text:
        raise ConfigError(f'mavlink.key_file = {str(path)!r}: empty, expected 32 bytes, '
                          '64 hex digits or a passphrase')
    try:
        key = bytes.fromhex(text.decode('ascii'))
    except ValueError:
        key = b''
    return key if len(key) == KEY_LENGTH else sha256(text).digest()


class Signing:
    """
    Checks the signatures of what comes and signs what goes.

    The newest timestamp of each stream is kept in a file beside the key: after a restart, what
    was taken before is a replay, and what is sent is newer than all that was sent. A crash loses
    the last `PERSIST_PERIOD_S` at most, by which what is sent then leaps ahead.

    pymavlink checks timestamps before signatures, so that one forged packet from the future locks
    the true sender out; here only a packet whose signature holds moves the time.
    """

    def __init__(self, key_file: Path, sender: dialect.MAVLink):
        self._key = load_key(key_file)
        self._state_file = Path(f'{key_file}.timestamps')
        self._timestamp, self._streams = _load_timestamps(self._state_file)
        try:
            self.save()
        except OSError as error:
            raise ConfigError(f'{self._state_file}: cannot be written, and what comes after a '
                              f'restart would not be told from replays: {error}') from error
        self._sender = sender.signing
        self._sender.secret_key = self._key
        self._sender.sign_outgoing = True

    def refusal(self, packet: Packet) -> str | None:
        """Return why a packet is not to be believed, or None and take its timestamp."""
        if not packet.is_signed:
            return 'mavlink_unsigned'
        signature = sha256(self._key + packet.data[:-6]).digest()[:6]
        if not compare_digest(signature, packet.data[-6:]):
            return 'mavlink_wrong_key'
        timestamp = int.from_bytes(packet.data[-12:-6], 'little')
        stream = f'{packet.data[-13]}/{packet.system}/{packet.component}'
        oldest = self._streams.get(stream, self._timestamp - _MAX_LAG - 1)
        if timestamp <= oldest:
            return 'mavlink_replayed'
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return None

    def stamp(self) -> None:
        """Give the packet that is signed next its timestamp."""
        self._timestamp = max(self._timestamp + 1, _ticks_now())
        self._sender.timestamp = self._timestamp

    def save(self) -> None:
        """Write the timestamps, whole or not at all."""
        state = {'timestamp': self._timestamp, 'streams': self._streams}
        with replacement(self._state_file, synced=True) as file:
            file.write(json.dumps(state).encode())


def _ticks_now() -> int:
    return int(max(0.0, time.time() - _EPOCH_2015_S) * _TICKS_PER_S)


def _load_timestamps(path: Path) -> tuple[int, dict[str, int]]:
    """Return what to send with, after all that was sent before, and the newest of each stream."""
    if not path.exists():
        return _ticks_now(), {}
    try:
        state = json.loads(path.read_text())
        sent, streams = int(state['timestamp']), dict(state['streams'])
        if not all(type(newest) is int for newest in streams.values()):
            raise ValueError('timestamps that are no integers')
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ConfigError(f'{path}: not the timestamps of a link: {error}') from error
    return max(_ticks_now(), sent + int(2 * PERSIST_PERIOD_S * _TICKS_PER_S)), streams
