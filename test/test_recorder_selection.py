"""Which topics a recorder takes: a list, an expression, all; less what is excluded."""

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.nodes.recorder_selection import TopicSelection
import pytest

TOPICS = ('/camera/image', '/camera/info', '/drone/_debug', '/odom')


def resolve(topic):
    if ' ' in topic:
        raise RuntimeError('invalid')
    return topic if topic.startswith('/') else f'/{topic}'


def selection(**parameters):
    return TopicSelection(RecorderConfig(**parameters), resolve, '/recorder/losses')


@pytest.mark.parametrize('parameters, chosen', [
    ({}, {'/camera/image', '/camera/info', '/odom'}),
    ({'include_hidden_topics': True}, set(TOPICS)),
    ({'topics': ('odom',)}, {'/odom'}),
    ({'topics': ('/drone/_debug',)}, {'/drone/_debug'}),
    ({'regex': '/camera/.*'}, {'/camera/image', '/camera/info'}),
    ({'regex': 'camera'}, set()),
    ({'regex': '/camera/.*', 'topics': ('/odom',)}, {'/camera/image', '/camera/info', '/odom'}),
    ({'exclude_regex': '/camera/.*'}, {'/odom'}),
    ({'exclude_topics': ('odom',)}, {'/camera/image', '/camera/info'}),
    ({'topics': ('/odom',), 'exclude_topics': ('/odom',)}, set()),
])
def test_a_choice_takes_what_it_names_less_what_is_excluded(parameters, chosen):
    assert {topic for topic in TOPICS if topic in selection(**parameters)} == chosen


@pytest.mark.parametrize('parameters', [
    {}, {'regex': '.*'}, {'topics': ('/recorder/losses',)}])
def test_what_the_recorder_writes_itself_is_never_chosen(parameters):
    assert '/recorder/losses' not in selection(**parameters)


@pytest.mark.parametrize('parameters, found, awaited', [
    ({}, (), []),
    ({'topics': ('/b', 'a')}, (), ['/a', '/b']),
    ({'topics': ('/b', '/a')}, ('/a',), ['/b']),
    ({'topics': ('/b', '/a'), 'exclude_topics': ('/b',)}, ('/a',), []),
    ({'regex': '/camera.*'}, (), ['topics that match /camera.*']),
    ({'regex': '/camera.*'}, ('/camera/info',), []),
])
def test_what_was_chosen_and_is_not_there_is_awaited(parameters, found, awaited):
    assert selection(**parameters).awaited(found) == awaited


@pytest.mark.parametrize('parameters, error', [
    ({'regex': '('}, r"recorder\.regex = '\('"),
    ({'exclude_regex': '['}, r"recorder\.exclude_regex = '\['"),
    ({'topics': ('a b',)}, "recorder.topics: 'a b' is no name of a topic"),
    ({'exclude_topics': ('a b',)}, "recorder.exclude_topics: 'a b' is no name of a topic")])
def test_what_cannot_be_a_choice_is_refused_by_name(parameters, error):
    with pytest.raises(ConfigError, match=error):
        selection(**parameters)
