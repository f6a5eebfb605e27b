"""An autopilot's packets, and what bad lines and bad people make of them."""

from __future__ import annotations

import math
import random
import struct

from dlsc_qbs_ros.io.mavlink.framing import dialect

UNKNOWN = [math.nan] + [0.0] * 20
FIELDS = [math.nan, math.inf, -math.inf, 0.0, 3e38, -1e-40, 1.0]


def heartbeat(boot_ns: int) -> dialect.MAVLink_message:
    """Return an autopilot's heartbeat."""
    return dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)


def odometry(boot_ns: int) -> dialect.MAVLink_message:
    """Return odometry that moves on with time."""
    angle = boot_ns * 1e-10
    return dialect.MAVLink_odometry_message(
        boot_ns // 1000, 1, 12, math.cos(angle), math.sin(angle), -1.0,
        [math.cos(angle), 0.0, 0.0, math.sin(angle)], 1.0, 0.1, 0.0, 0.0, 0.0, 0.1,
        UNKNOWN, UNKNOWN, 0, 8, 100)


def position(boot_ns: int) -> dialect.MAVLink_message:
    """Return a position."""
    return dialect.MAVLink_local_position_ned_message(
        boot_ns // 1_000_000, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3)


def attitude(boot_ns: int) -> dialect.MAVLink_message:
    """Return an attitude."""
    return dialect.MAVLink_attitude_message(
        boot_ns // 1_000_000, 0.1, 0.2, 0.3, 0.0, 0.0, 0.1)


def time_request(boot_ns: int) -> dialect.MAVLink_message:
    """Return a question for the time."""
    return dialect.MAVLink_timesync_message(0, boot_ns)


def acknowledgement(boot_ns: int) -> dialect.MAVLink_message:
    """Return an answer to a request for a rate."""
    return dialect.MAVLink_command_ack_message(511, 0)


MESSAGES = [heartbeat, odometry, odometry, position, attitude, time_request, acknowledgement]


def flip(packet: bytearray, rng: random.Random) -> bytearray:
    """Change some bits of a byte."""
    packet[rng.randrange(len(packet))] ^= rng.randrange(1, 256)
    return packet


def cut(packet: bytearray, rng: random.Random) -> bytearray:
    """Lose an end."""
    at = rng.randrange(1, len(packet) + 1)
    return packet[:at] if rng.random() < 0.5 else packet[-at:]


def lose(packet: bytearray, rng: random.Random) -> bytearray:
    """Lose some bytes from the middle."""
    at = rng.randrange(len(packet))
    return packet[:at] + packet[at + rng.randrange(1, 9):] or packet


def add(packet: bytearray, rng: random.Random) -> bytearray:
    """Gain some bytes, of those that look like a start more than of others."""
    at = rng.randrange(len(packet) + 1)
    noise = rng.choice([rng.randbytes(rng.randrange(1, 40)), b'\xfd' * 3, b'\xfe\xff'])
    return packet[:at] + noise + packet[at:]


def run_together(packet: bytearray, rng: random.Random) -> bytearray:
    """Go on with a part of the same again."""
    return packet + packet[:rng.randrange(1, len(packet) + 1)]


DAMAGES = [flip, flip, cut, lose, add, run_together]


def damaged(packet: bytearray, crc_extra: int, rng: random.Random) -> bytes:
    """Return what a bad line makes of a packet."""
    packet = flip(packet, rng)
    for _ in range(rng.randrange(3)):
        packet = rng.choice(DAMAGES)(packet, rng)
    return bytes(packet)


def forged(packet: bytearray, crc_extra: int, rng: random.Random) -> bytes:
    """Return a packet with other contents and a checksum that holds."""
    payload = packet[10:-2]
    for _ in range(rng.randrange(1, 5)):
        at = rng.randrange(len(payload))
        value = rng.choice([rng.randbytes(4), rng.randbytes(8), bytes([rng.randrange(256)]),
                            struct.pack('<f', rng.choice(FIELDS))])
        payload[at:at + len(value)] = value[:len(payload) - at]
    checked = bytes(packet[1:10] + payload)
    checksum = dialect.x25crc(checked + bytes([crc_extra])).crc
    return bytes(packet[:1]) + checked + checksum.to_bytes(2, 'little')
