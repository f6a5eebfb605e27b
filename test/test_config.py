"""One declaration per parameter; what is unknown, of another type or out of range is refused."""

from dataclasses import FrozenInstanceError
from math import inf, nan
import re

import pytest

from dlsc_qbs_ros.config import Config, PARAMETERS
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.profiles import load_profile, parse_assignment

NUMBERS = {key: spec for key, spec in PARAMETERS.items() if spec.metadata['bounds']}
WORDS = {key: spec for key, spec in PARAMETERS.items() if spec.metadata['choices']}
FLOATS = [key for key, spec in PARAMETERS.items() if type(spec.default) is float]
INTEGERS = [key for key, spec in PARAMETERS.items() if type(spec.default) is int]


def refusal(*values):
    """Return a pattern: the literal parts, in order, anything between them."""
    return '.*'.join(re.escape(str(value)) for value in values)


def out_of_bounds(spec):
    low, high = spec.metadata['bounds']
    if type(spec.default) is int:
        return low - 1, high + 1
    return low - abs(low) * 0.5 - 1e-12, high * 1.5


def write(tmp_path, text):
    path = tmp_path / 'profile.yaml'
    path.write_text(text)
    return path


# Declarations

def test_every_parameter_is_a_key_of_the_flat_configuration():
    assert list(Config().flat()) == list(PARAMETERS)
    assert {'encoder.n_atoms', 'view.width', 'ratslam.threshold'} <= set(PARAMETERS)


@pytest.mark.parametrize('key', PARAMETERS)
def test_a_parameter_says_what_it_means_and_which_values_it_takes(key):
    spec = PARAMETERS[key]
    assert spec.metadata['meaning']
    assert type(spec.default) in (bool, int, float, str, tuple)
    assert bool(spec.metadata['bounds']) == (type(spec.default) in (int, float))


def test_defaults_are_those_of_the_slam_experiments_of_the_paper():
    flat = Config().flat()
    assert {key: flat[f'encoder.{key}'] for key in (
        'eta_c', 'eta_d', 'lambda_1', 'n_coding', 'n_learning', 'n_atoms', 'sigma_w',
        'gate_window')} == {
            'eta_c': 5e-3, 'eta_d': 1.4e-3, 'lambda_1': 0.2, 'n_coding': 10, 'n_learning': 1,
            'n_atoms': 64, 'sigma_w': 0.01, 'gate_window': 5}
    assert flat['ratslam.sample_period_s'] == 0.1


def test_a_configuration_cannot_be_changed_in_place():
    with pytest.raises(FrozenInstanceError):
        Config().encoder.n_atoms = 3


# Overrides

def test_an_override_replaces_what_it_names_and_nothing_else():
    changed = Config().override({'encoder.n_atoms': 32, 'view.width': 64})
    assert (changed.encoder.n_atoms, changed.view.width) == (32, 64)
    differing = {key for key, value in changed.flat().items() if value != Config().flat()[key]}
    assert differing == {'encoder.n_atoms', 'view.width'}
    assert Config().encoder.n_atoms == 64
    again = changed.override({'encoder.seed': 5})
    assert (again.encoder.n_atoms, again.encoder.seed) == (32, 5)


def test_a_flat_configuration_makes_the_same_configuration_again():
    config = Config().override({
        'encoder.mode': 'paper', 'recorder.topics': ('/a', '/b'), 'ratslam.threshold': 0.5})
    assert Config().override(config.flat()) == config
    assert Config().override({}) == Config()


@pytest.mark.parametrize('key', ['encoder.atoms', 'n_atoms', 'encoder', 'encodr.n_atoms', ''])
def test_an_unknown_parameter_is_refused_by_name_and_value(key):
    with pytest.raises(ConfigError, match=refusal('unknown parameter', repr(key), 7)):
        Config().override({key: 7})


@pytest.mark.parametrize('key', NUMBERS)
def test_a_number_out_of_range_is_refused_with_its_bounds(key):
    low, high = NUMBERS[key].metadata['bounds']
    for value in out_of_bounds(NUMBERS[key]):
        with pytest.raises(ConfigError, match=refusal(key, '=', value, f'[{low}, {high}]')):
            Config().override({key: value})


@pytest.mark.parametrize('key', NUMBERS)
def test_bounds_themselves_are_in_range(key):
    for bound in NUMBERS[key].metadata['bounds']:
        assert Config().override({key: bound}).flat()[key] == bound


@pytest.mark.parametrize('key', WORDS)
def test_a_word_that_is_no_choice_is_refused_with_the_choices(key):
    choices = WORDS[key].metadata['choices']
    with pytest.raises(ConfigError, match=refusal(key, "'else'", 'one of', ', '.join(choices))):
        Config().override({key: 'else'})
    for choice in choices:
        assert Config().override({key: choice}).flat()[key] == choice


@pytest.mark.parametrize('key', PARAMETERS)
def test_a_value_of_another_type_is_refused_with_the_type(key):
    wanted = type(PARAMETERS[key].default)
    others = {bool: (1, 'yes', None), int: (1.0, True, '8', None), float: (True, '1', None, [1.0]),
              str: (1, None, ['a']), tuple: ('a', 1, None, {})}[wanted]
    for value in others:
        with pytest.raises(ConfigError, match=refusal(
                key, '=', repr(value), 'expected', wanted.__name__)):
            Config().override({key: value})


@pytest.mark.parametrize('key', FLOATS)
@pytest.mark.parametrize('value', [nan, inf, -inf])
def test_a_number_that_is_not_finite_is_refused(key, value):
    with pytest.raises(ConfigError, match=refusal(key, '=', value, 'finite')):
        Config().override({key: value})


def test_an_integer_stands_for_a_float():
    value = Config().override({'encoder.eta_c': 1}).encoder.eta_c
    assert (value, type(value)) == (1.0, float)


@pytest.mark.parametrize('topics', [[1], ['/a', None], [['/a']]])
def test_a_list_of_anything_but_strings_is_refused(topics):
    with pytest.raises(ConfigError, match=refusal(
            'recorder.topics', '=', repr(topics), 'list of strings')):
        Config().override({'recorder.topics': topics})


def test_a_list_becomes_a_tuple():
    assert Config().override({'recorder.topics': ['/a', '/b']}).recorder.topics == ('/a', '/b')


@pytest.mark.parametrize('one, other', [
    ('crop_top', 'crop_bottom'), ('crop_left', 'crop_right')])
def test_a_crop_must_leave_a_tenth(one, other):
    Config().override({f'view.{one}': 0.5, f'view.{other}': 0.4})
    with pytest.raises(ConfigError, match=refusal(
            f'view.{one}', f'view.{other}', '= 0.95', 'at most 0.9')):
        Config().override({f'view.{one}': 0.5, f'view.{other}': 0.45})


# The command line

@pytest.mark.parametrize('text, expected', [
    ('encoder.n_atoms=32', ('encoder.n_atoms', 32)),
    ('encoder.eta_c=1e-3', ('encoder.eta_c', 0.001)),
    ('encoder.eta_c = 0.5', ('encoder.eta_c', 0.5)),
    ('encoder.gate=false', ('encoder.gate', False)),
    ('encoder.mode=paper', ('encoder.mode', 'paper')),
    ('recorder.topics=[/a, /b]', ('recorder.topics', ['/a', '/b'])),
    ('recorder.regex=/cam.*=x', ('recorder.regex', '/cam.*=x')),
])
def test_an_assignment_is_a_key_and_a_yaml_value(text, expected):
    assert parse_assignment(text) == expected


@pytest.mark.parametrize('text, message', [
    ('encoder.n_atoms', "'encoder.n_atoms': expected section.name=value"),
    ('encoder.n_atoms=[1', "'[1' is not YAML"),
    ('recorder.output=2024-13-01', "'2024-13-01' is not YAML"),
])
def test_what_is_no_assignment_is_refused(text, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        parse_assignment(text)


def test_a_number_that_is_none_is_refused_by_name_and_value():
    with pytest.raises(ConfigError, match="encoder.eta_c = 'fast': expected float"):
        Config().override(dict([parse_assignment('encoder.eta_c=fast')]))


# Profiles

def test_a_profile_is_a_ros_parameter_file(tmp_path):
    profile = load_profile(write(tmp_path, """
/**:
  ros__parameters:
    use_sim_time: true
    encoder: {eta_c: 1e-3, n_atoms: 32}
    ratslam.threshold: 0.9
    qos_overrides:
      /odom: {subscription: {reliability: reliable}}
recorder:
  ros__parameters:
    start_type_description_service: false
    recorder:
      topics: [/a]
"""))
    assert profile == {'encoder.eta_c': 0.001, 'encoder.n_atoms': 32, 'ratslam.threshold': 0.9,
                       'recorder.topics': ['/a']}
    assert Config().override(profile).encoder.eta_c == 0.001


def test_a_whole_configuration_survives_the_file(tmp_path):
    config = Config().override({
        'encoder.eta_c': 1e-5, 'recorder.topics': ('/a',), 'image.compressed': True})
    lines = [f'    {key}: {list(value) if isinstance(value, tuple) else value!r}'
             for key, value in config.flat().items()]
    profile = load_profile(write(
        tmp_path, '\n'.join(['/**:', '  ros__parameters:', *lines]).replace(
            'True', 'true').replace('False', 'false')))
    assert Config().override(profile) == config


@pytest.mark.parametrize('text, message', [
    ('', 'expected a mapping, found None'),
    ('[1, 2]', 'expected a mapping'),
    ('encoder: 3', 'expected a mapping, found 3'),
    ('encoder: {n_atoms: 3}', "'encoder' holds no ros__parameters"),
    ('/**: {ros__parameters: [1]}', r'expected a mapping, found \[1\]'),
    ('/**: {', 'not a readable YAML file'),
    ('/**: {ros__parameters: {recorder.output: 2024-13-01}}', 'not a readable YAML file'),
])
def test_a_file_that_is_no_profile_is_refused_by_name(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=f'{re.escape(str(path))}.*{message}'):
        load_profile(path)


def test_a_file_that_cannot_be_read_is_refused_by_name(tmp_path):
    with pytest.raises(ConfigError, match='missing.yaml: not a readable YAML file'):
        load_profile(tmp_path / 'missing.yaml')
    with pytest.raises(ConfigError, match='not a readable YAML file'):
        load_profile(tmp_path)
    (tmp_path / 'bytes.yaml').write_bytes(b'\xff\xfe\x00\x81')
    with pytest.raises(ConfigError, match='bytes.yaml: not a readable YAML file'):
        load_profile(tmp_path / 'bytes.yaml')


def test_a_profile_with_an_unknown_key_is_refused_when_it_is_put_in_force(tmp_path):
    profile = load_profile(write(tmp_path, '/**: {ros__parameters: {view: {breadth: 3}}}'))
    with pytest.raises(ConfigError, match="unknown parameter 'view.breadth'"):
        Config().override(profile)
