"""A pipeline whose live parameters are changed is the one that was made with them."""

from collections import deque
from collections.abc import Mapping

from dlsc_qbs_ros.config import Config, PARAMETERS
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.pipeline.odometry import OdometryNormaliser
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
import numpy as np
import pytest

LIVE = [name for name, spec in PARAMETERS.items() if spec.metadata['live']]
PIPELINE = ('ratslam', 'odometry')


def another(name):
    """Return a value of a parameter that is not its default."""
    spec = PARAMETERS[name]
    default, bounds, choices = spec.default, spec.metadata['bounds'], spec.metadata['choices']
    if isinstance(default, bool):
        return not default
    if isinstance(default, str):
        return next((choice for choice in choices if choice != default), f'{default}x')
    return type(default)((default + bounds[1]) / 2 if default < bounds[1] else bounds[0])


def leaves(value, path='', within=()):
    """Yield (path, value) of all that an object of the package is made of."""
    if isinstance(value, (bool, int, float, str, np.ndarray, type(None))):
        yield path, np.asarray(value).tolist()
    elif isinstance(value, Mapping):
        for key in value:
            yield from leaves(value[key], f'{path}[{key!r}]', within)
    elif isinstance(value, (tuple, list, deque)):
        for index, item in enumerate(value):
            yield from leaves(item, f'{path}[{index}]', within)
    elif type(value).__module__.startswith('dlsc_qbs_ros') and id(value) not in within:
        for name, item in vars(value).items():
            yield from leaves(item, f'{path}.{name}', (*within, id(value)))


def parts(ratslam):
    """Return what it is made of, less the code book: view and encoder are never live."""
    return {path: value for path, value in leaves(ratslam) if not path.startswith('._book')}


@pytest.mark.parametrize('name', [name for name in LIVE if name.startswith(PIPELINE)])
def test_a_pipeline_reconfigured_is_the_one_made_so(name):
    config = Config().override({name: another(name)})
    ratslam, normaliser = RatSlam(Config()), OdometryNormaliser(Config().odometry)
    assert dict(leaves(config)) != dict(leaves(Config()))
    ratslam.reconfigure(config)
    normaliser.reconfigure(config.odometry)
    assert parts(ratslam) == parts(RatSlam(config))
    assert dict(leaves(normaliser)) == dict(leaves(OdometryNormaliser(config.odometry)))


@pytest.mark.parametrize('name', LIVE)
def test_a_live_parameter_changes(name):
    assert Config().retuned({name: another(name)}) == Config().override({name: another(name)})


@pytest.mark.parametrize('name', [name for name in PARAMETERS if name not in LIVE])
def test_a_parameter_that_is_not_live_says_why_it_stays(name):
    spec, value = PARAMETERS[name], another(name) if PARAMETERS[name].default != () else ('/a',)
    section = getattr(Config(), name.partition('.')[0])
    assert not spec.metadata['live'] and section.fixed_by
    with pytest.raises(ConfigError):  # of some, another value alone is refused in any case
        Config().retuned({name: value})
