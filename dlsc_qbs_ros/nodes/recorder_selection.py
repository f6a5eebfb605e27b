"""Which topics a recorder records."""

from __future__ import annotations

import re
from typing import Callable, Collection

from ..config import RecorderConfig
from ..errors import ConfigError


class TopicSelection:
    """
    What is on the list or matches the expression, all topics without either; less exclusions.

    `resolve` makes full names of relative ones and raises RuntimeError where there is none. The
    topic `without`, the recorder's own, is never chosen.
    """

    def __init__(self, config: RecorderConfig, resolve: Callable[[str], str], without: str):
        self._regex = config.regex
        self._pattern = _compiled('regex', config.regex)
        self._excluded_pattern = _compiled('exclude_regex', config.exclude_regex)
        self._names = _resolved('topics', config.topics, resolve)
        self._excluded_names = {
            without, *_resolved('exclude_topics', config.exclude_topics, resolve)}
        self._with_hidden = config.include_hidden_topics

    def __contains__(self, topic: str) -> bool:
        if topic in self._excluded_names or _matches(self._excluded_pattern, topic):
            return False
        if not self._names and self._pattern is None:
            return self._with_hidden or not any(
                token.startswith('_') for token in topic.split('/'))
        return topic in self._names or _matches(self._pattern, topic)

    def awaited(self, found: Collection[str]) -> list[str]:
        """Return what was asked for and is not among the topics found."""
        if self._pattern is not None and not found:
            return [f'topics that match {self._regex}']
        return sorted(name for name in self._names if name in self and name not in found)


def _resolved(name: str, topics: Collection[str], resolve: Callable[[str], str]) -> set[str]:
    full_names = set()
    for topic in topics:
        try:
            full_names.add(resolve(topic))
        except RuntimeError as error:
            raise ConfigError(f'recorder.{name}: {topic!r} is no name of a topic') from error
    return full_names


def _compiled(name: str, regex: str) -> re.Pattern | None:
    try:
        return re.compile(regex) if regex else None
    except re.error as error:
        raise ConfigError(f'recorder.{name} = {regex!r}: {error}') from error


def _matches(pattern: re.Pattern | None, topic: str) -> bool:
    return pattern is not None and pattern.fullmatch(topic) is not None
