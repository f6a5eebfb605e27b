"""Definitions and hashes of message types, found beside the ROS installation that is in use."""

from __future__ import annotations

from functools import lru_cache
import json
import os
from pathlib import Path
import re
import sys

from ...errors import RecordingError

_SEPARATOR = '=' * 80
_FIELD_TYPE = re.compile(r'^(?P<type>[A-Za-z][\w/]*)')
_IDL_INCLUDE = re.compile(r'^[ \t]*#include\s+["<]([\w/]+)\.idl[">].*\n?', re.MULTILINE)
_PRIMITIVES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16',
    'int32', 'uint32', 'int64', 'uint64', 'string', 'wstring'))


@lru_cache(maxsize=None)
def schema(type_name: str) -> tuple[str, str]:
    """
    Return the encoding and text that tell readers of a file what a type looks like.

    `ros2msg` where the definition and those it needs are installed as .msg, else `ros2idl`, in
    which every part, the first too, has a heading and none includes another: all are there.

    Raises
    ------
    RecordingError
        When they are installed as neither.

    """
    try:
        return 'ros2msg', message_definition(type_name)
    except RecordingError:
        texts = _idl_texts(type_name)
        if texts is None:
            raise
    return 'ros2idl', '\n'.join(
        f'{_SEPARATOR}\nIDL: {name}\n{_IDL_INCLUDE.sub("", text)}' for name, text in texts.items())


@lru_cache(maxsize=None)
def message_definition(type_name: str) -> str:
    """
    Return the `ros2msg` text of a type: its own, then that of each dependency, once.

    Raises
    ------
    RecordingError
        When the definition of the type or of a dependency is not installed.

    """
    texts = {type_name: _text(type_name)}
    _add_dependencies(type_name, texts)
    root, *dependencies = texts.items()
    return root[1] + ''.join(
        f'\n{_SEPARATOR}\nMSG: {name.replace("/msg/", "/")}\n{text}'
        for name, text in dependencies)


@lru_cache(maxsize=None)
def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type, or '' where the installation does not tell it."""
    path = _find(type_name, '.json')
    if path is None:
        return ''
    hashes = json.loads(path.read_text(encoding='utf-8'))['type_hashes']
    return next((entry['hash_string'] for entry in hashes if entry['type_name'] == type_name), '')


def _add_dependencies(type_name: str, texts: dict[str, str]) -> None:
    for name in _field_types(type_name, texts[type_name]):
        if name not in texts:
            texts[name] = _text(name)
            _add_dependencies(name, texts)


def _field_types(type_name: str, text: str) -> list[str]:
    """Return the full names of the message types that a definition's fields have."""
    package = type_name.split('/')[0]
    names = []
    for line in text.splitlines():
        match = _FIELD_TYPE.match(line.strip())
        if match is None or match['type'] in _PRIMITIVES:
            continue
        parts = match['type'].split('/')
        names.append('/'.join((parts[0] if len(parts) > 1 else package, 'msg', parts[-1])))
    return names


def _idl_texts(type_name: str) -> dict[str, str] | None:
    """Return the .idl texts of a type and all it includes, or None where one is missing."""
    texts: dict[str, str] = {}
    missing = [type_name]
    while missing:
        name = missing.pop(0)
        path = _find(name, '.idl')
        if path is None:
            return None
        texts[name] = path.read_text(encoding='utf-8')
        missing += [found for found in _IDL_INCLUDE.findall(texts[name])
                    if found not in texts and found not in missing]
    return texts


def _text(type_name: str) -> str:
    path = _find(type_name, '.msg')
    if path is None:
        raise RecordingError(f'no message definition of {type_name!r} is installed')
    return path.read_text(encoding='utf-8')


def _find(type_name: str, suffix: str) -> Path | None:
    """Look in a sourced ROS first, then in the environment this interpreter belongs to."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) + [sys.prefix]
    package, _, name = type_name.partition('/msg/')
    paths = (Path(prefix, 'share', package, 'msg', name + suffix) for prefix in prefixes if prefix)
    return next((path for path in paths if path.is_file()), None)
