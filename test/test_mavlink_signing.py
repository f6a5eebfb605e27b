"""With a key, only who has it is believed, once; time goes on over restarts."""

from hashlib import sha256
import json
import os

from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.io.mavlink.framing import Framer
from dlsc_qbs_ros.io.mavlink.signing import load_key, Signing
from mavlink_peer import dialect, heartbeat, odometry, Peer
import pytest

KEY = bytes(range(32))
NOW = 2 ** 46  # decades ahead: that of the peer, which is what counts


@pytest.fixture
def key_file(tmp_path):
    return secret(tmp_path / 'key', KEY)


def secret(path, content, mode=0o600):
    path.write_bytes(content)
    path.chmod(mode)
    return path


def signing(key_file):
    return Signing(key_file, dialect.MAVLink(None, 1, 191))


def packets(peer, n=1):
    data = b''.join(peer.pack(odometry(1.0)) for _ in range(n))
    return list(Framer(True).feed(data))


@pytest.mark.parametrize('content, key', [
    (KEY, KEY),
    (KEY.hex().encode() + b'\n', KEY),
    (KEY.hex().upper().encode(), KEY),
    (b'correct horse battery staple\n', sha256(b'correct horse battery staple').digest()),
    (b'abcd', sha256(b'abcd').digest()),
    (b'p' * 31 + b'\n', sha256(b'p' * 31).digest())],
    ids=['32 bytes', 'hex', 'upper case', 'passphrase', 'short hex is a passphrase',
         'a line of 32 bytes is a passphrase'])
def test_a_key_is_32_bytes_or_their_hex_digits_or_a_passphrase(tmp_path, content, key):
    assert load_key(secret(tmp_path / 'key', content)) == key


@pytest.mark.parametrize('mode', [0o640, 0o604, 0o620, 0o777])
def test_a_key_that_others_can_touch_is_refused(tmp_path, mode):
    with pytest.raises(ConfigError, match=f'mode {mode:04o}, expected .* as 0600'):
        load_key(secret(tmp_path / 'key', KEY, mode))


def test_a_key_that_is_none_is_refused(tmp_path):
    with pytest.raises(ConfigError, match='No such file'):
        load_key(tmp_path / 'gone')
    with pytest.raises(ConfigError, match='empty, expected 32 bytes'):
        load_key(secret(tmp_path / 'key', b' \n'))


def test_packets_of_who_has_the_key_are_believed_once(key_file):
    checker = signing(key_file)
    for packet in packets(Peer(key=KEY), 3):
        assert checker.refusal(packet) is None
        assert checker.refusal(packet) == 'mavlink_replayed'


def test_unsigned_packets_and_those_of_another_key_are_refused(key_file):
    checker = signing(key_file)
    assert checker.refusal(packets(Peer())[0]) == 'mavlink_unsigned'
    assert checker.refusal(packets(Peer(key=bytes(32)))[0]) == 'mavlink_wrong_key'
    old, = Framer(True).feed(Peer().pack(heartbeat(), force_mavlink1=True))
    assert checker.refusal(old) == 'mavlink_unsigned'


def test_a_forged_packet_from_the_future_does_not_lock_the_true_sender_out(key_file):
    checker, true = signing(key_file), Peer(key=KEY)
    assert checker.refusal(packets(true)[0]) is None
    forged = packets(Peer(key=bytes(32), timestamp=2 ** 47))[0]
    assert checker.refusal(forged) == 'mavlink_wrong_key'
    assert checker.refusal(packets(true)[0]) is None


def test_a_stream_not_met_before_may_lag_a_minute_and_no_more(key_file):
    checker = signing(key_file)
    assert checker.refusal(packets(Peer(key=KEY, timestamp=NOW))[0]) is None
    for component, lag_s, refusal in ((2, 59, None), (3, 61, 'mavlink_replayed')):
        peer = Peer(1, component, KEY, NOW - lag_s * 100_000)
        assert checker.refusal(packets(peer)[0]) == refusal


def test_after_a_restart_what_was_taken_is_a_replay_and_what_is_sent_is_newer(key_file):
    first, taken = signing(key_file), packets(Peer(key=KEY), 3)
    assert [first.refusal(packet) for packet in taken] == [None] * 3
    first.stamp()
    first.save()
    again, sender = Signing(key_file, mav := dialect.MAVLink(None, 1, 191)), mav.signing
    assert {again.refusal(packet) for packet in taken} == {'mavlink_replayed'}
    again.stamp()
    assert sender.timestamp > NOW + 3
    assert again.refusal(packets(Peer(key=KEY, timestamp=NOW + 3))[0]) is None


def test_a_crash_before_the_timestamps_were_saved_is_leapt_over(key_file):
    signing(key_file)
    lost = Signing(key_file, mav := dialect.MAVLink(None, 1, 191))
    for _ in range(100):
        lost.stamp()
    sent = mav.signing.timestamp
    Signing(key_file, mav).stamp()
    assert mav.signing.timestamp > sent + 5 * 100_000


def test_what_is_signed_is_believed_by_the_other_side(key_file):
    mav = dialect.MAVLink(None, 1, 191)
    sender = Signing(key_file, mav)
    other = dialect.MAVLink(None, 1, 1)
    other.signing.secret_key = KEY
    other.signing.allow_unsigned_callback = lambda *_: False
    for _ in range(3):
        sender.stamp()
        packet = bytearray(heartbeat().pack(mav))
        assert other.decode(packet).get_signed()
    with pytest.raises(dialect.MAVError, match='Invalid signature'):
        other.decode(packet)


def test_timestamps_are_written_whole_or_not_at_all(key_file, monkeypatch):
    checker = signing(key_file)
    state_file = key_file.with_name('key.timestamps')
    before = json.loads(state_file.read_text())
    assert checker.refusal(packets(Peer(key=KEY))[0]) is None

    def crash(descriptor):
        raise OSError('no space left on device')
    monkeypatch.setattr(os, 'fsync', crash)
    with pytest.raises(OSError):
        checker.save()
    assert json.loads(state_file.read_text()) == before


@pytest.mark.parametrize('content', ['', '[]', '{"timestamp": 1}',
                                     '{"timestamp": 1, "streams": {"0/1/1": "x"}}'])
def test_timestamps_that_are_none_are_refused_rather_than_replays_accepted(key_file, content):
    key_file.with_name('key.timestamps').write_text(content)
    with pytest.raises(ConfigError, match='not the timestamps of a link'):
        signing(key_file)


def test_a_folder_that_cannot_be_written_is_refused(key_file, monkeypatch):
    def refuse(*_):
        raise PermissionError('read-only')
    monkeypatch.setattr(os, 'replace', refuse)
    with pytest.raises(ConfigError, match='cannot be written'):
        signing(key_file)
