"""Messages ↔ CDR bytes, by the name of their type."""

from __future__ import annotations

from importlib import import_module
import struct

from rclpy.serialization import deserialize_message, serialize_message

from ..errors import RecordingError


def type_name(msg) -> str:
    """Return the full type name of a message or a message class, `package/msg/Type`."""
    msg_type = msg if isinstance(msg, type) else type(msg)
    return f'{msg_type.__module__.split(".")[0]}/msg/{msg_type.__name__}'


def message_type(name: str) -> type:
    """
    Return the message class of a full type name.

    Raises
    ------
    RecordingError
        When there is no such message or its package is not installed.

    """
    package, middle, short = (name.split('/') + ['', ''])[:3]
    try:
        if middle != 'msg':
            raise ImportError('no message type')
        return getattr(import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError, ValueError) as error:
        raise RecordingError(f'message type {name!r} is not installed') from error


def serialize(msg) -> bytes:
    """Return the message as CDR, with its 4-byte header."""
    return serialize_message(msg)


def deserialize(data: bytes, name: str):
    """
    Return the message that CDR data of a named type holds.

    Raises
    ------
    RecordingError
        When the type is not installed or the data is cut or of another type.

    """
    msg_type = message_type(name)
    try:
        return deserialize_message(data, msg_type)
    except RuntimeError as error:
        raise RecordingError(f'{len(data)} bytes cannot be read as {name}') from error


def begins_with_header(name: str) -> bool:
    """Whether the messages of a full type name begin with a std_msgs/Header."""
    fields = message_type(name).get_fields_and_field_types()
    return next(iter(fields.values()), None) == 'std_msgs/Header'


def header_stamp_ns(data: bytes) -> int:
    """
    Return the stamp of a serialised message that begins with a std_msgs/Header.

    Raises
    ------
    RecordingError
        When the data is too short to hold one.

    """
    sec, nanosec = struct.unpack_from(_stamp_format(data), data, 4)
    return sec * 1_000_000_000 + nanosec


def with_header_stamp(data: bytes, stamp_ns: int) -> bytes:
    """Return the same message with another stamp; see `header_stamp_ns`."""
    stamp = struct.pack(_stamp_format(data), *divmod(stamp_ns, 1_000_000_000))
    return data[:4] + stamp + data[12:]


def _stamp_format(data: bytes) -> str:
    if len(data) < 12:
        raise RecordingError(f'{len(data)} bytes hold no header')
    return '<iI' if data[1] & 1 else '>iI'
