"""Profiles of single topics, from a file such as rosbag2's --qos-profile-overrides-path."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import Any, Mapping

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy)
import yaml

from ..errors import ConfigError

Overrides = Mapping[str, Mapping[str, Any]]

_WORDS = {'history': HistoryPolicy, 'reliability': ReliabilityPolicy,
          'durability': DurabilityPolicy, 'liveliness': LivelinessPolicy}
_NUMBERS = {'depth': int, 'avoid_ros_namespace_conventions': bool}
_DURATIONS = ('deadline', 'lifespan', 'liveliness_lease_duration')


def load_qos_overrides(path: Path | str) -> Overrides:
    """
    Return topic → policy → value, as `overridden` takes them, of a YAML file; none without one.

    Raises
    ------
    ConfigError
        When the file cannot be read, or a topic, policy or value is none; it names which.

    """
    if not path:
        return {}
    try:
        document = yaml.safe_load(Path(path).read_text())
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise ConfigError(f'{path}: not a readable YAML file: {error}') from error
    if not isinstance(document, Mapping):
        raise ConfigError(f'{path}: expected profiles by topic, found {document!r}')
    for topic, words in document.items():
        if not str(topic).startswith('/') or not isinstance(words, Mapping):
            raise ConfigError(f'{path}: expected the profile of a /topic, found {topic}: {words}')
    return {topic: {policy: _value(f'{path}: {topic}: {policy}', policy, word)
                    for policy, word in words.items()}
            for topic, words in document.items()}


def overridden(qos: QoSProfile, values: Mapping[str, Any]) -> QoSProfile:
    """Return the profile with those of its policies replaced that have a value."""
    qos = copy(qos)
    for policy, value in values.items():
        setattr(qos, policy, value)
    return qos


def _value(name: str, policy: str, word: Any) -> Any:
    if policy in _WORDS:
        known = [key for key in _WORDS[policy].short_keys() if key != 'unknown']
        if word not in known:
            raise ConfigError(f'{name} = {word!r}: expected one of {", ".join(known)}')
        return _WORDS[policy](_WORDS[policy].get_from_short_key(word))
    if policy in _NUMBERS:
        if type(word) is not _NUMBERS[policy] or word < 0:
            raise ConfigError(f'{name} = {word!r}: expected {_NUMBERS[policy].__name__}')
        return word
    if policy not in _DURATIONS:
        raise ConfigError(f'{name}: no such policy; expected one of '
                          f'{", ".join([*_WORDS, *_NUMBERS, *_DURATIONS])}')
    try:
        return Duration(seconds=word['sec'], nanoseconds=word['nsec'])
    except (KeyError, TypeError) as error:
        raise ConfigError(f'{name} = {word!r}: expected {{sec: …, nsec: …}}') from error
