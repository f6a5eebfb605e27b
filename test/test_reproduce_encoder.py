"""The paper's figure on the encoder: what is run, what is found in it, what the tool writes."""

from collections import Counter
from dataclasses import asdict
import json
from types import SimpleNamespace

from algorithm_1 import algorithm_1
from loop_flight import events, frames
import numpy as np
import pytest
from vectors import vectors_of
import yaml

from dlsc_qbs_ros.cli import reproduce_encoder
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.evaluation.encoder_figure import (
    atoms_finding, distinct_atoms, replay_finding, run_away_finding, structure)
from dlsc_qbs_ros.evaluation.encoder_plots import plot_atoms, plot_replay, plot_run_away
from dlsc_qbs_ros.pipeline.continual_learning import learn, random_schedule, replay, views_of
from dlsc_qbs_ros.profiles import load_profile

CONFIG = Config().override({'view.width': 16, 'view.height': 12, 'encoder.n_atoms': 8})
# Runs away within the circle, whichever way the learner rounds.
WILD = CONFIG.override(
    {'view.standardise': False, 'encoder.eta_d': 0.02, 'encoder.eta_c': 0.002})
SMALL = ['--set', 'view.width=16', '--set', 'view.height=12', '--set', 'encoder.n_atoms=8']
NAN = float('nan')


@pytest.fixture(scope='module')
def views():
    """Return the views of a round of the circle."""
    return views_of(frames(12.0), CONFIG.view, Counter())


def literal(views, config, start, **changes):
    names = ('eta_c', 'eta_d', 'lambda_1', 'n_coding', 'n_learning', 'gate')
    parameters = {name: getattr(config.encoder, name) for name in names}
    inputs = vectors_of(np.array(views), config.view.standardise)
    return list(algorithm_1(inputs, start.T, **{**parameters, **changes}))


class TestLearning:
    """Algorithm 1 along a sequence, and the replay."""

    def test_without_a_schedule_the_gate_of_algorithm_1_decides(self, views):
        learning = learn(views, CONFIG)
        steps = literal(views, CONFIG, learn([], CONFIG).atoms)
        assert learning.learned.tolist() == [step.learned for step in steps]
        assert 10 < learning.learned.sum() < len(views) - 10
        np.testing.assert_allclose(learning.errors, [step.error for step in steps], rtol=1e-4)
        np.testing.assert_allclose(learn(views[:-1], CONFIG).atoms, steps[-1].dictionary.T,
                                   atol=1e-4 * np.abs(learning.atoms).max())

    def test_a_schedule_decides_in_the_place_of_the_gate(self, views):
        steps = literal(views, CONFIG, learn([], CONFIG).atoms, gate=False)
        always = learn(views, CONFIG, np.ones(len(views), bool))
        np.testing.assert_allclose(always.errors, [step.error for step in steps], rtol=1e-4)
        schedule = random_schedule(len(views), 30, seed=0)
        np.testing.assert_array_equal(learn(views, CONFIG, schedule).learned, schedule)
        never = learn(views, CONFIG, np.zeros(len(views), bool))
        np.testing.assert_array_equal(never.atoms, learn([], CONFIG).atoms)

    def test_replay_is_algorithm_1_with_the_dictionary_held(self, views):
        atoms = learn(views, CONFIG).atoms
        before = atoms.copy()
        steps = literal(views, CONFIG, atoms, n_learning=0)
        np.testing.assert_allclose(
            replay(views, CONFIG, atoms), [step.error for step in steps], rtol=1e-4)
        np.testing.assert_array_equal(atoms, before)

    @pytest.mark.filterwarnings('error')
    def test_a_run_ends_with_the_first_error_that_is_not_finite_and_without_a_warning(
            self, views):
        learning = learn(views, WILD, np.ones(len(views), bool))
        end = np.isnan(learning.errors).argmax()
        assert 50 < end < len(views)
        assert np.isfinite(learning.errors[:end]).all() and np.isnan(learning.errors[end:]).all()
        assert learning.learned[:end].all() and not learning.learned[end:].any()
        assert learning.stable[0] and not learning.stable[end - 1:].any()
        assert np.isnan(replay(views, WILD, learning.atoms)).all()

    def test_stable_says_whether_coding_converges_after_each_frame(self, views):
        learning = learn(views, WILD, np.ones(len(views), bool))
        for k in range(np.isnan(learning.errors).argmax()):
            atoms = learn(views[:k + 1], WILD, np.ones(k + 1, bool)).atoms.astype(float)
            if not np.isfinite(atoms).all():
                break
            share = np.linalg.eigvalsh(atoms @ atoms.T)[-1] / (2 / WILD.encoder.eta_c)
            if abs(share - 1) > 0.05:  # the Gram matrix the learner carries along is less exact
                assert learning.stable[k] == (share < 1)
        assert 50 < learning.stable.argmin() < k

    def test_a_random_schedule_has_as_many_frames_as_asked_for_and_follows_its_seed(self):
        schedules = [random_schedule(1000, 300, seed) for seed in (0, 0, 1)]
        assert [schedule.sum() for schedule in schedules] == 3 * [300]
        np.testing.assert_array_equal(schedules[0], schedules[1])
        assert (schedules[0] & schedules[2]).sum() < 150
        assert schedules[0][:500].sum() == pytest.approx(150, abs=30)

    def test_frames_that_an_encoder_refuses_are_left_out_and_counted(self):
        first, second, third = frames(0.3)
        refused = Counter()
        bad = Frame(third.stamp_ns, third.grey[:0])
        kept = views_of([first, third, second, bad], CONFIG.view, refused)
        assert len(kept) == refused['frames'] == 2


def course(errors=(1.0, 1.0), learned=(True, True), stable=(True, True), atoms=None):
    return SimpleNamespace(errors=np.array(errors), learned=np.array(learned),
                           stable=np.array(stable), atoms=atoms)


class TestFindings:
    """What the numbers say, by hand."""

    def test_the_lower_mean_of_the_replay_decides(self):
        gated, always = course(learned=(True, False)), course()
        finding = replay_finding((gated, np.array([3.0, 1.0])), (always, np.array([2.0, 4.0])),
                                 [(gated, np.array([1.0, 5.0])), (gated, np.array([2.5, 2.5]))])
        assert finding.held
        numbers = finding.as_json()
        assert numbers['with_qbs'] == {
            'learning_frames': 1, 'left_stable_range_at': None, 'learning_not_finite_at': None,
            'replay_not_finite_at': None, 'mean': 2.0, 'median': 2.0}
        assert numbers['without_qbs']['mean'] == 3.0
        assert [run['mean'] for run in numbers['random_frames']] == [3.0, 2.5]
        assert numbers['share_lower_with_qbs'] == 0.5
        assert numbers['better_than_random_frames']
        assert finding.sentence == (
            '(a) held: mean replay error 2 with QBS, learned from 1 of 2 frames, 3 without, '
            'lower with QBS on 50% of the frames; as many frames drawn at random give 3, 2.5: '
            "the gate's choice is better than each of these.")

    def test_where_less_learning_alone_does_as_well_the_sentence_says_so(self):
        run = (course(), np.array([2.0, 2.0]))
        finding = replay_finding(run, (course(), np.array([1.0, 1.0])), [run])
        assert not finding.held and not finding.as_json()['better_than_random_frames']
        assert '(a) did not hold: mean replay error 2 with QBS' in finding.sentence
        assert "the gate's choice is not better" in finding.sentence

    def test_a_replay_that_is_not_finite_is_worse_than_any_and_null_in_json(self):
        lost = course((1.0, NAN), stable=(False, False))
        finding = replay_finding((course(), np.array([9.0, 9.0])), (lost, np.array([NAN, NAN])),
                                 [(course(), np.array([9.5, NAN]))])
        assert finding.held
        assert finding.as_json()['without_qbs'] == {
            'learning_frames': 2, 'left_stable_range_at': 0, 'learning_not_finite_at': 1,
            'replay_not_finite_at': 0, 'mean': None, 'median': None}
        assert ('not finite without (its dictionary left the stable range at frame 0 and was not '
                'finite from frame 1 on)') in finding.sentence
        json.dumps(finding.as_json(), allow_nan=False)

    @pytest.mark.parametrize('gated, always, held', [
        ((True, True), (True, False), True), ((True, True), (True, True), False),
        ((False, True), (True, False), False), ((False, True), (True, True), False)])
    def test_run_away_is_the_paper_s_when_it_happens_without_qbs_alone(
            self, gated, always, held):
        assert run_away_finding(course(stable=gated), course(stable=always)).held is held

    def test_a_run_away_is_told_with_its_frames(self):
        lost = course((1.0, 7.0, 1e20, NAN), 4 * [True], (True, True, False, False))
        back = course((1.0, 9.0, 2.0, 1.0), 4 * [True], (True, False, True, True))
        finding = run_away_finding(back, lost)
        assert finding.sentence == (
            '(b) did not hold: without QBS the dictionary left the stable range at frame 2 and '
            'was not finite from frame 3 on; with QBS it left the stable range at frame 1, was '
            'outside for 1 frames (largest error 9).')
        assert finding.as_json()['without_qbs'] == {
            'learning_frames': 4, 'left_stable_range_at': 2, 'frames_outside': 2,
            'not_finite_at': 3, 'median_error': 7.0, 'largest_finite_error': 1e20}
        assert 'stayed in the stable range (largest error 1)' in run_away_finding(
            course(), course()).sentence

    def test_distinct_atoms_counts_orthogonal_atoms_whatever_their_length(self):
        rows = np.linalg.qr(np.random.default_rng(0).normal(size=(12, 12)))[0][:5]
        assert distinct_atoms(rows) == pytest.approx(5.0)
        assert distinct_atoms(rows * np.array([[1.0], [2.0], [1e-9], [-7.0], [1e9]])
                              ) == pytest.approx(5.0)
        assert distinct_atoms(np.repeat(rows[:1], 5, axis=0)) == pytest.approx(1.0)
        assert distinct_atoms(rows[[0, 0, 1, 1]]) == pytest.approx(2.0)

    def test_structure_is_the_correlation_of_neighbours(self):
        row, column = np.mgrid[:40, :50]
        atoms = np.array([(-1.0) ** (row + column), 5.0 + np.sin(row / 9) * np.sin(column / 9),
                          np.random.default_rng(0).normal(size=(40, 50)),
                          (-1.0) ** row, (-1.0) ** column, np.ones((40, 50))])
        found = structure(atoms.reshape(6, -1), 40, 50)
        np.testing.assert_allclose(found[:5], [-1.0, 1.0, 0.0, 0.0, 0.0], atol=0.05)
        assert np.isnan(found[5])

    def test_features_are_more_diverse_when_more_of_them_are_distinct(self):
        row, column = np.mgrid[:12, :16]
        waves = np.array([np.sin(n * row / 5) * np.cos(m * column / 5)
                          for n in (1, 2) for m in (1, 2)]).reshape(4, -1)
        noise = np.random.default_rng(0).normal(size=waves.shape)
        start, diverse, alike = course(atoms=noise), course(atoms=waves), course(
            atoms=waves[[0, 0, 0, 1]])
        finding = atoms_finding(start, diverse, alike, 12, 16)
        assert finding.held
        assert finding.as_json()['with_qbs']['structured_atoms'] == 4
        assert finding.as_json()['start']['structured_atoms'] == 0
        assert not atoms_finding(start, alike, diverse, 12, 16).held
        assert not atoms_finding(start, start, alike, 12, 16).held

    def test_what_is_left_of_a_dictionary_that_ran_away_counts_for_nothing(self):
        row, column = np.mgrid[:12, :16]
        atoms = np.array([row + column, row - column], float).reshape(2, -1)
        kept, lost = course(atoms=atoms), course((1.0, NAN), stable=(True, False), atoms=atoms)
        finding = atoms_finding(kept, kept, lost, 12, 16)
        assert finding.held
        assert finding.as_json()['without_qbs'] == {
            'atoms': 2, 'structured_atoms': 0, 'median_structure': 0.0, 'distinct_atoms': 0.0}
        assert 'not finite from frame 1 on' in finding.sentence


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('errors, stable', [
    (4 * [1.0], 4 * [True]), ([1.0, 1e300, NAN, NAN], [True, False, False, False]),
    (4 * [NAN], 4 * [False])], ids=['stable', 'runs away', 'never finite'])
def test_pictures_are_drawn_whatever_became_of_a_run(errors, stable, tmp_path):
    run, calm = course(errors, 4 * [True], stable), course(4 * [2.0], 4 * [True], 4 * [True])
    plot_run_away(tmp_path / 'b.png', calm, run, 'note')
    plot_run_away(tmp_path / 'c.png', run, run, 'note')
    plot_replay(tmp_path / 'a.png', calm.errors, run.errors, [run.errors], 'note')
    plot_replay(tmp_path / 'd.png', run.errors, run.errors, [run.errors], 'note')
    plot_atoms(tmp_path / 'e.png', np.array([errors]), 2, 2, 'note')
    for path in tmp_path.iterdir():
        assert path.read_bytes().startswith(b'\x89PNG')


@pytest.fixture
def flight(tmp_path, monkeypatch):
    """Return the path of a flight round the circle; a stand-in reads it, of `n_s` seconds."""
    path = tmp_path / 'flight.mcap'
    path.write_text('12.0')
    monkeypatch.setattr(
        reproduce_encoder, 'read_flight',
        lambda path, image_topic, odom_topic, refused: events(float(path.read_text())))
    return path


class TestTool:
    """The command line."""

    def test_leaves_pictures_numbers_and_configuration_and_prints_a_sentence_per_panel(
            self, flight, tmp_path, capsys):
        out = tmp_path / 'deep' / 'out'
        assert reproduce_encoder.main([str(flight), *SMALL, '--out', str(out)]) == 0
        assert sorted(path.name for path in out.iterdir()) == [
            'atoms.png', 'config.yaml', 'encoder.json', 'replay_loss.png', 'run_away.png']
        document = json.loads((out / 'encoder.json').read_text())
        assert document['frames'] == 120 and document['view']['width'] == 16
        panels = [document[name] for name in ('replay_loss', 'run_away', 'atoms')]
        printed, err = capsys.readouterr()
        assert printed.splitlines()[:3] == [panel['sentence'] for panel in panels]
        for letter, panel in zip('abc', panels):
            verdict = 'held' if panel['held'] else 'did not hold'
            assert panel['sentence'].startswith(f'({letter}) {verdict}: ')
        assert err == ''

    def test_each_panel_has_the_parameters_of_the_paper(self, flight, tmp_path):
        out = tmp_path / 'out'
        reproduce_encoder.main([str(flight), *SMALL, '--out', str(out)])
        document = json.loads((out / 'encoder.json').read_text())
        common = {'n_coding': 10, 'n_learning': 1, 'n_atoms': 8}
        for name, eta_c, lambda_1, eta_d in (('replay_loss', 5e-3, 0.5, 2e-3),
                                             ('run_away', 1e-2, 0.25, 4e-3),
                                             ('atoms', 5e-3, 0.5, 2e-3)):
            expected = {**common, 'eta_c': eta_c, 'lambda_1': lambda_1, 'eta_d': eta_d}
            assert expected.items() <= document[name]['parameters'].items()

    def test_the_numbers_are_those_of_the_runs(self, flight, tmp_path, views):
        out = tmp_path / 'out'
        reproduce_encoder.main([str(flight), *SMALL, '--out', str(out)])
        document = json.loads((out / 'encoder.json').read_text())
        a, b = (CONFIG.override(panel) for panel in reproduce_encoder.PANELS.values())
        gated, always = learn(views, a), learn(views, a, np.ones(len(views), bool))
        numbers = document['replay_loss']
        for name, learning in (('with_qbs', gated), ('without_qbs', always)):
            assert numbers[name]['learning_frames'] == learning.learned.sum()
            assert numbers[name]['mean'] == pytest.approx(replay(views, a, learning.atoms).mean())
        assert [run['learning_frames'] for run in numbers['random_frames']] == (
            3 * [gated.learned.sum()])
        assert len({run['mean'] for run in numbers['random_frames']}) == 3
        for name, schedule in (('with_qbs', None), ('without_qbs', np.ones(len(views), bool))):
            assert document['run_away'][name]['median_error'] == pytest.approx(
                np.nanmedian(learn(views, b, schedule).errors))
        assert document['atoms']['with_qbs']['distinct_atoms'] == pytest.approx(
            distinct_atoms(gated.atoms))

    def test_left_out_the_size_of_images_is_that_of_the_paper(self, flight, tmp_path):
        flight.write_text('5.1')
        reproduce_encoder.main([str(flight), '--set', 'encoder.n_atoms=2', '--out',
                                str(tmp_path / 'out')])
        written = load_profile(tmp_path / 'out' / 'config.yaml')
        assert (written['view.width'], written['view.height'], written['view.standardise']) == (
            346, 260, True)

    def test_configuration_reads_back_and_names_what_panel_b_has_otherwise(
            self, flight, tmp_path):
        profile = tmp_path / 'profile.yaml'
        profile.write_text('/**:\n  ros__parameters:\n    encoder: {eta_c: 1e-3, seed: 3}\n')
        out = tmp_path / 'out'
        assert reproduce_encoder.main([
            str(flight), *SMALL, '--config', str(profile), '--set', 'encoder.seed=4',
            '--out', str(out)]) == 0
        text = (out / 'config.yaml').read_text()
        config = Config().override(load_profile(out / 'config.yaml'))
        assert (config.encoder.eta_c, config.encoder.seed, config.encoder.eta_d) == (1e-3, 4, 2e-3)
        assert [line for line in text.splitlines() if line.startswith('#')] == [
            '# panel b: encoder.eta_d = 0.004', '# panel b: encoder.lambda_1 = 0.25']
        document = json.loads((out / 'encoder.json').read_text())
        assert document['atoms']['parameters'] == asdict(config.encoder)
        assert document['run_away']['parameters']['eta_c'] == 1e-3
        assert yaml.safe_load(text)

    @pytest.mark.filterwarnings('error')
    def test_a_dictionary_that_runs_away_is_told_and_nothing_else_is(
            self, flight, tmp_path, capsys):
        assert reproduce_encoder.main([
            str(flight), *SMALL, '--set', 'encoder.eta_d=0.2', '--out', str(tmp_path / 'o')]) == 0
        out, err = capsys.readouterr()
        assert out.count('not finite') >= 3 and err == ''

    def test_a_parameter_without_effect_is_told(self, flight, tmp_path, capsys):
        reproduce_encoder.main([str(flight), *SMALL, '--set', 'encoder.gate=false', '--out',
                                str(tmp_path / 'out')])
        assert capsys.readouterr().err == (
            'reproduce_encoder: encoder.gate has no effect: learning runs with the gate and '
            'without, unprotected\n')


class TestRefusals:
    """Expected errors: one line, exit code 1."""

    def refused(self, capsys, *arguments):
        assert reproduce_encoder.main(list(map(str, arguments))) == 1
        out, err = capsys.readouterr()
        assert out == '' and err.count('\n') == 1 and err.startswith('reproduce_encoder: ')
        return err

    def test_a_flight_too_short(self, flight, tmp_path, capsys):
        flight.write_text('4.0')
        assert f'{flight}: expected at least 50 frames, found 40' in self.refused(
            capsys, flight, *SMALL, '--out', tmp_path / 'out')

    @pytest.mark.parametrize('assignment, message', [
        ('view.depth=3', "unknown parameter 'view.depth'"),
        ('encoder.n_atoms=0', 'encoder.n_atoms = 0: expected a value in [1, 4096]')])
    def test_a_wrong_parameter(self, assignment, message, flight, tmp_path, capsys):
        assert message in self.refused(
            capsys, flight, '--set', assignment, '--out', tmp_path / 'out')
        assert not (tmp_path / 'out').exists()

    def test_a_folder_that_cannot_be_written(self, flight, tmp_path, capsys):
        (tmp_path / 'out').touch()
        assert f"--out {tmp_path / 'out'}: cannot be written" in self.refused(
            capsys, flight, *SMALL, '--out', tmp_path / 'out')

    def test_no_such_flight(self, tmp_path, capsys):
        assert str(tmp_path / 'none.mcap') in self.refused(
            capsys, tmp_path / 'none.mcap', '--out', tmp_path / 'out')

    def test_a_flight_without_images_or_without_the_topic_asked_for(self, tmp_path, capsys):
        pytest.importorskip('rclpy', reason='recordings are decoded by ROS')
        from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
        with BagWriter(tmp_path / 'flight') as writer:
            writer.add_topic('/odom', 'nav_msgs/msg/Odometry')
        out = ('--out', tmp_path / 'out')
        assert 'expected one topic of sensor_msgs/msg/Image' in self.refused(
            capsys, tmp_path / 'flight', *out)
        assert "no topic '/left'; it has /odom" in self.refused(
            capsys, tmp_path / 'flight', '--image-topic', '/left', *out)
