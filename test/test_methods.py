"""The rows of the table: names, parameters and the mu of each in its own units."""

from pathlib import Path

from dlsc_qbs_ros.cli.methods import METHODS, Source
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Frame, GroundTruthSample, Pose2
from dlsc_qbs_ros.errors import ModelError
import numpy as np
import pytest

DESCRIBED = [name for name, method in METHODS.items()
             if method.make and method.grid and not method.has_network]


def source():
    """Return what a method may ask for, of two frames with ground truth."""
    grey = np.random.default_rng(0).integers(0, 255, (2, 120, 160), np.uint8)
    frames = [Frame(k * 10**9, image) for k, image in enumerate(grey)]
    truth = [GroundTruthSample(k * 10**9, Pose2(0.2 * k, 0.0, 0.0)) for k in range(2)]
    return frames, Source(None, lambda: [*frames, *truth])


def test_every_row_of_the_paper_s_table_and_every_control_has_its_name():
    assert {'ratslam', 'vgg11', 'latentslam', 'orb', 'dlsc_qbs', 'dlsc_qbs_paper', 'dlsc',
            'dlsc_qbs_image', 'dlsc_qbs_patches', 'image_frozen', 'image_no_gate',
            'patches_frozen', 'patches_no_gate', 'onnx', 'thumbnail', 'hog', 'odometry',
            'oracle'} == set(METHODS)


def test_the_default_row_is_what_the_nodes_run():
    assert METHODS['dlsc_qbs'].configured(Config(), 1, None) == Config()


@pytest.mark.parametrize('name', DESCRIBED)
def test_a_frame_is_described_and_is_most_like_itself(name):
    frames, given = source()
    describe, measure = METHODS[name].make(given)
    first, second = (measure.prepare(describe(frame)) for frame in frames)
    itself, other = measure.direction * measure.compare(first, np.stack([first, second]))
    assert itself > other


@pytest.mark.parametrize('name', DESCRIBED)
def test_mu_lies_between_its_own_kind_and_nothing_in_common_the_strictest_first(name):
    frames, given = source()
    _, measure = METHODS[name].make(given)
    method = METHODS[name]
    grid = measure.direction * np.array(method.grid)
    assert (np.diff(grid) < 0.0).all()
    assert grid[-1] > measure.direction * measure.worst
    assert grid[0] >= measure.direction * method.threshold >= grid[-1]


def test_odometry_alone_sees_nothing():
    frames, given = source()
    describe, _ = METHODS['odometry'].make(given)
    assert not describe(frames[0]).any()


@pytest.mark.parametrize('name', METHODS)
def test_its_parameters_leave_all_others_to_the_user(name):
    method = METHODS[name]
    config = Config().override({'patches.size': 7, 'encoder.seed': 5, 'pose_cells.size_xy': 30})
    changed = {key for key, value in method.configured(config, 1, None).flat().items()
               if value != config.flat()[key]}
    assert changed <= {*method.decides(), 'ratslam.tracking_threshold'}


def test_a_frozen_dictionary_never_learns_and_the_gate_can_be_left_out():
    for kind in ('image', 'patches'):
        frozen, open_ = (METHODS[f'{kind}_{control}'].configured(Config(), 1, None).encoder
                         for control in ('frozen', 'no_gate'))
        assert frozen.input == open_.input == kind
        assert frozen.n_learning == 0
        assert not open_.gate


def test_a_network_is_asked_for_by_the_rows_that_have_one():
    given = Source(Path('absent.onnx'), lambda: [])
    for name, method in METHODS.items():
        if method.has_network:
            with pytest.raises(ModelError, match='absent.onnx: cannot be read'):
                method.make(given)
