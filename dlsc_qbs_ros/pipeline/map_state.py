"""What a map is made of, array by array, and whether what claims to be one can be gone on from."""

from __future__ import annotations

from typing import Any, Mapping, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .dead_reckoning import MAX_ERRORS
from ..config import Config
from ..core.inputs import make_inputs
from ..core.pose_cells import N_HEADINGS
from ..errors import MapError

# What a map's views, codes and pose cells are only good for together with.
SHAPING = ('encoder.input', 'encoder.mode', 'encoder.n_atoms', 'patches.size',
           'patches.cells_x', 'patches.cells_y', 'pose_cells.size_xy', 'pose_cells.cell_size_m')
LARGEST = 1e12  # seconds too, of a clock that was set from 1970 to now
MAX_BREAKS = 1e6
# Of the gyro's state; no noise is 0, and so long it is looked at.
GYRO = ((-1e3, -1e3, 0.0, 0.0, 1e-9, 1.0), (1e3, 1e3, 1.0, 1.0, 1e3, 1e3))
MAX_STATIONS = 1e6  # as many views as a run may have, each after a gap, are not half of it


class Array(NamedTuple):
    """
    One array of a map.

    A word in `shape` is a number that is the same wherever the word stands; the values of an
    array with `index_of` count what that word counts.
    """

    dtype: str
    shape: tuple
    meaning: str
    index_of: str = ''


ARRAYS = {
    'experience_poses': Array('<f8', ('experiences', 3), 'x, y in metres and yaw in the map'),
    'experience_births': Array('<i8', ('experiences',), 'the visit that made it', 'visits'),
    'experience_view_cells': Array('<i8', ('experiences',), 'what is seen there', 'view_cells'),
    'experience_pose_cells': Array('<f8', ('experiences', 3), 'x, y, heading in pose cells'),
    'link_ends': Array('<i8', ('links', 2), 'from and to', 'experiences'),
    'link_motions': Array('<f8', ('links', 3), 'the pose of the one in the frame of the other'),
    'link_is_closure': Array('|b1', ('links',), 'whether it led to what was there before'),
    'link_makers': Array('<i8', ('links',), 'the visit that made it, or -1'),
    'view_cell_views': Array('|u1', ('view_cells', 'rows', 'columns'), 'grey pixels'),
    'view_cell_codes': Array(
        '<f4', ('codes', 'values'), 'of length 1; none where the dictionary gives them again'),
    'view_cell_pose_cells': Array('<f8', ('view_cells', 3), 'where the packet was, in pose cells'),
    'view_cell_decays': Array('<f8', ('view_cells',), 'how spent its power to inject is'),
    'dictionaries': Array('<f4', ('dictionaries', 'atoms', 'inputs'), 'that in force, or none'),
    'dictionary_stamps_ns': Array('<i8', ('dictionaries',), 'its name'),
    'visit_experiences': Array('<i8', ('visits',), 'the experience visited', 'experiences'),
    'visit_offsets': Array('<f8', ('visits', 3), 'the robot in the frame of the experience'),
    'visit_tracks': Array('<f8', ('visits', 3), 'the robot by odometry alone'),
    'visit_runs': Array('<i8', ('visits',), 'the run of matches it belongs to, 0 for none'),
    'visit_flown': Array('<f8', ('visits', 3), 'seconds in motion, metres, breaks so far'),
    'closure_visits': Array('<i8', ('closures',), 'those under test', 'visits'),
    'put_segments': Array('<i8', ('puts', 2), 'segments of odometry that are one without a visit'),
    'looks': Array('<i8', ('looks', 3), 'stations since the last views, how unsure that is, and '
                   'the view cells that there were'),
    'look_likenesses': Array('<f4', ('looks', 'view_cells'), 'of these views to each of those'),
    'pose_cells': Array('<f8', ('headings', 'size_xy', 'size_xy'), 'their activity'),
    'odometry_stamp_ns': Array('<i8', (1,), 'of the last odometry that was used'),
    'odometry': Array('<f8', (6,), 'it: x, y, yaw, z, roll, pitch'),
    'gyro': Array('<f8', (6,), 'the lens, the error of the yaw rate in rad/s, their variances, '
                  'and the noise seen: in rad^2, in seconds'),
    'robot_track': Array('<f8', (3,), 'the robot by odometry alone'),
    'robot_start': Array('<f8', (7,), 'where it set out: from the visit that it stands by, by '
                         'odometry alone, and in seconds in motion'),
    'robot_stand': Array('<i8', (1,), 'that visit; -1 for the last one'),
    'robot_flown': Array('<f8', (3,), 'seconds in motion, metres, breaks so far'),
    'robot_drift': Array('<f8', (4,), 'deviations at the last anchor in m, rad; m, s since'),
    'odometry_errors': Array('<f8', ('segments', 2), 'of yaw rate, in rad/s, and of scale'),
    'run_counts': Array('<i8', (2,), 'runs of matches there were, and were taken back'),
    'run_metres': Array('<f8', (3,), 'flown at its start, at its next test, at the last match'),
}


def shaping(config: Config) -> dict[str, Any]:
    """Return those parameters that a map can only be gone on in with."""
    return {key: value for key, value in config.flat().items()
            if key.startswith('view.') or key in SHAPING}


def refuse_other(saved: Mapping[str, Any], config: Config) -> None:
    """Raise MapError when a map was made with other `shaping` parameters than these."""
    for key, value in shaping(config).items():
        if saved.get(key) != value:
            raise MapError(
                f'made with {key} = {saved.get(key)}: expected {value}, as this node has')


def check(state: Mapping[str, np.ndarray], config: Config) -> None:
    """Raise MapError when it is no map that can be gone on from, whatever happens then."""
    for kind, names in (('unknown', state.keys() - ARRAYS), ('missing', ARRAYS.keys() - state)):
        if names:
            raise MapError(f'{kind} array {sorted(names)[0]!r}')
    inputs = make_inputs(config)
    sizes = {'rows': config.view.height, 'columns': config.view.width, 'headings': N_HEADINGS,
             'size_xy': config.pose_cells.size_xy, 'atoms': config.encoder.n_atoms,
             'inputs': inputs.n_inputs, 'values': inputs.n_values}
    for name, spec in ARRAYS.items():
        _check_array(name, state[name], spec, sizes)
    for name, spec in ARRAYS.items():
        if spec.index_of:
            _require(_within(state[name], 0, sizes[spec.index_of] - 1), name,
                     f'indices below {sizes[spec.index_of]}')
    _check_sense(state, sizes)


def _check_array(name: str, array: np.ndarray, spec: Array, sizes: dict[str, int]) -> None:
    _require(array.dtype.str == spec.dtype and array.ndim == len(spec.shape), name,
             f'{len(spec.shape)} axes of {spec.dtype}')
    expected = tuple(sizes.setdefault(word, n) if isinstance(word, str) else word
                     for word, n in zip(spec.shape, array.shape))
    _require(array.shape == expected, name, f'the shape {expected}')
    if array.dtype.kind == 'f':
        _require(_within(array, -LARGEST, LARGEST), name, 'finite numbers of a sane size')


def _check_sense(state: Mapping[str, np.ndarray], sizes: dict[str, int]) -> None:
    """Check what one number means for another, where nonsense would end the node later."""
    flown = np.vstack([np.zeros(3), state['visit_flown'], state['robot_flown']])
    breaks, births = flown[:, 2], state['experience_births']
    for name, holds, expected in (
            ('experience_poses', sizes['experiences'] > 0, 'at least one'),
            ('experience_births', (np.diff(births) > 0).all() and np.array_equal(
                state['visit_experiences'][births], np.arange(len(births))),
             'a rising visit of each experience'),
            ('experience_view_cells',
             len(np.unique(state['experience_view_cells'])) == sizes['view_cells'],
             'an experience for every view cell'),
            ('view_cell_codes', sizes['dictionaries'] == (0 if sizes['codes'] else 1)
             and sizes['codes'] in (0, sizes['view_cells']), 'either all, or a dictionary'),
            ('dictionaries', all(map(np.any, state['dictionaries'])), 'atoms that are not all 0'),
            ('visit_flown', (np.diff(flown, axis=0) >= 0.0).all() and breaks[-1] <= MAX_BREAKS
             and (breaks == np.floor(breaks)).all(), 'what never falls, in whole breaks'),
            ('odometry_errors', sizes['segments'] <= breaks[-1] + 1
             and _within(state['odometry_errors'], -MAX_ERRORS, MAX_ERRORS),
             'errors of segments there were'),
            ('put_segments', _within(state['put_segments'], 0, breaks[-1]), 'segments there were'),
            ('visit_runs', _within(state['visit_runs'], 0, state['run_counts'][0])
             and not state['visit_runs'][births].any(), 'runs there were, of places met again'),
            ('looks', _within(state['looks'], 0, MAX_STATIONS), 'stations and view cells'),
            ('run_counts', _within(state['run_counts'], 0, LARGEST), 'counts'),
            ('link_makers', _within(state['link_makers'], -1, sizes['visits'] - 1), 'visits'),
            ('robot_stand', _within(state['robot_stand'], -1, sizes['visits'] - 1), 'a visit'),
            ('gyro', _within(state['gyro'], *GYRO), 'variances and a noise'),
            ('robot_drift', _within(state['robot_drift'], 0.0, LARGEST), 'none below 0'),
            ('view_cell_decays', _within(state['view_cell_decays'], 0.0, LARGEST), 'a decay'),
            ('pose_cells', _within(state['pose_cells'], 0.0, LARGEST)
             and state['pose_cells'].sum() > 1e-9, 'some activity, none below 0')):
        _require(holds, name, expected)


def _within(array: np.ndarray, low: ArrayLike, high: ArrayLike) -> bool:
    """Whether all values are within bounds; one that is not a number is not."""
    return bool(((array >= low) & (array <= high)).all())


def _require(holds: bool, name: str, expected: str) -> None:
    if not holds:
        raise MapError(f'{name!r} holds something else than {expected}')
