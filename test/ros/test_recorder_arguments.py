"""The command line of the recorder has the words of `ros2 bag record`."""

from dataclasses import fields

from dlsc_qbs_ros.config import Config, RecorderConfig
from dlsc_qbs_ros.nodes.recorder_arguments import parameters_from
import pytest


@pytest.mark.parametrize('line, parameters', [
    ('', {}),
    ('-a', {}),
    ('/a /b -o out', {'recorder.topics': ['/a', '/b'], 'recorder.output': 'out'}),
    ('/a --topics /b', {'recorder.topics': ['/a', '/b']}),
    ('-e /a.* --exclude-regex /ab --exclude-topics /ac /ad',
     {'recorder.regex': '/a.*', 'recorder.exclude_regex': '/ab',
      'recorder.exclude_topics': ['/ac', '/ad']}),
    ('--max-bag-size 1000 --max-bag-duration 2 --compression-format zstd',
     {'recorder.max_bytes': 1000, 'recorder.max_duration_s': 2.0,
      'recorder.compression': 'zstd'}),
    ('--start-paused --use-sim-time --include-hidden-topics',
     {'recorder.start_paused': True, 'recorder.include_hidden_topics': True,
      'use_sim_time': True})])
def test_each_option_is_a_parameter(line, parameters):
    assert {p.name: p.value for p in parameters_from(line.split())} == parameters


def test_every_parameter_of_the_recorder_has_an_option():
    for spec in fields(RecorderConfig):
        value = {bool: [], int: ['3'], float: ['0.5'], tuple: ['a']}.get(
            type(spec.default), [*spec.metadata['choices'], 'a'][:1])
        given, = parameters_from([f'--{spec.name.replace("_", "-")}', *value])
        assert given.name == f'recorder.{spec.name}'
        Config().override({given.name: given.value})


@pytest.mark.parametrize('line, error', [
    ('-a /a', '--all and a choice of topics exclude each other'),
    ('-a -e /a', '--all and a choice of topics exclude each other'),
    ('--max-bag-size large', 'invalid int value'),
    ('--no-such-option', 'unrecognized arguments: --no-such-option')])
def test_what_makes_no_sense_is_refused(line, error, capsys):
    with pytest.raises(SystemExit, match='2'):
        parameters_from(line.split())
    assert error in capsys.readouterr().err
