"""The evaluate command: what it writes, what it prints and how it refuses."""

from itertools import product
import json
import subprocess
import sys

from dlsc_qbs_ros.cli import evaluate, job
from dlsc_qbs_ros.cli.methods import METHODS
from dlsc_qbs_ros.config import Config, MavlinkConfig
from dlsc_qbs_ros.core.types import Frame, GroundTruthSample, OdometrySample, Pose2
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.pipeline.runner import EncodedFlight, RunResult
from dlsc_qbs_ros.profiles import load_profile
import numpy as np
import pytest

SECOND_NS = 10**9
N = 40
COUNTS = {'frames': N, 'view_cells': 5, 'experiences': N, 'closures': 1, 'learning_frames': 3,
          'epochs': 2}


def positions():
    return np.random.default_rng(0).normal(size=(N, 2)).cumsum(axis=0)


def events(with_truth=True):
    for k, (x, y) in enumerate(positions().tolist()):
        pose = Pose2(x, y, 0.0)
        yield OdometrySample(k * SECOND_NS, pose)
        if with_truth:
            yield GroundTruthSample(k * SECOND_NS, pose)
        yield Frame(k * SECOND_NS, np.zeros((4, 4), np.uint8))


class Pipeline:
    """Stands in for reader and pipeline: the error of the run grows with |threshold - best|."""

    def __init__(self):
        self.with_truth, self.usable, self.best = True, slice(None), 0.7
        self.read, self.links, self.encoded, self.mapped = [], [], [], []

    def read_flight(self, path, image_topic, odom_topic, ground_truth_topic,
                    refused, tlog, mavlink):
        self.read.append((path, image_topic, odom_topic, ground_truth_topic))
        self.links.append((tlog, mavlink))
        refused['/camera/image_raw'] += 7
        if path.stat().st_size:
            raise RecordingError(f'{path}: not an MCAP file')
        return events(self.with_truth)

    def encode(self, stream, config, encoder):
        stream = list(stream)
        assert not any(isinstance(event, GroundTruthSample) for event in stream)
        self.encoded.append(config)
        return EncodedFlight(stream, COUNTS, 0.04)

    def map_codes(self, encoded, config, measure):
        assert len(encoded.events) == 2 * N
        self.mapped.append(config)
        poses = np.column_stack([positions(), np.zeros(N)])
        direction = measure.direction if measure else 1
        poses[::2, 0] += 10.0 * abs(direction * config.ratslam.threshold - self.best)
        poses = poses[self.usable]
        return RunResult(
            np.arange(N, dtype=np.int64)[self.usable] * SECOND_NS, poses, poses[:, :2],
            poses, poses, poses, np.arange(len(poses)),
            np.zeros((0, 2), np.int64), np.array([[0, 9]]), np.zeros((1, 3)),
            COUNTS, 0.1)


@pytest.fixture
def pipeline(monkeypatch):
    """Put the stand-in in the place of reader and pipeline."""
    fake = Pipeline()
    for name in ('read_flight', 'encode', 'map_codes'):
        monkeypatch.setattr(job, name, getattr(fake, name))
    monkeypatch.setattr(job, 'recognise', lambda *_: None)
    monkeypatch.setattr(evaluate, 'spread', lambda work, jobs, *_: map(work, jobs))
    return fake


@pytest.fixture
def flight(tmp_path):
    """Return the path of a recording that the stand-in reads."""
    path = tmp_path / 'flight_1.mcap'
    path.touch()
    return path


def rows_of(out):
    return json.loads((out / 'metrics.json').read_text())['rows']


class TestResults:
    """What a successful evaluation leaves behind."""

    def test_writes_metrics_configuration_and_one_picture_per_row(
            self, pipeline, flight, tmp_path, capsys):
        out = tmp_path / 'deep' / 'out'
        assert evaluate.main([str(flight), '--encoder', 'dlsc_qbs,dlsc', '--out', str(out)]) == 0
        assert sorted(path.name for path in out.iterdir()) == [
            'config.yaml', 'flight_1_dlsc.png', 'flight_1_dlsc_qbs.png', 'metrics.json',
            'timing.json']
        rows = rows_of(out)
        assert [(row['flight'], row['encoder']) for row in rows] == [
            ('flight_1', 'dlsc_qbs'), ('flight_1', 'dlsc')]
        assert all(row['mae_l'] is not None and row['frames'] == N for row in rows)
        captured = capsys.readouterr()
        assert 'MAE_L | MAE_M' in captured.out
        assert 'flight_1 dlsc: 7 messages of /camera/image_raw refused' in captured.out
        assert captured.err == ''

    def test_the_default_encoder_is_the_paper_s_own(self, pipeline, flight, tmp_path):
        assert evaluate.main([str(flight), '--out', str(tmp_path / 'out')]) == 0
        assert [row['encoder'] for row in rows_of(tmp_path / 'out')] == ['dlsc_qbs']

    def test_each_encoder_changes_the_configuration_of_its_own_rows(
            self, pipeline, flight, tmp_path):
        evaluate.main([str(flight), '--encoder', 'dlsc_qbs_paper,dlsc,dlsc_qbs', '--out',
                       str(tmp_path / 'out')])
        assert [(config.encoder.mode, config.encoder.gate) for config in pipeline.encoded] == [
            ('paper', True), ('epochs', False), ('epochs', True)]

    @pytest.mark.parametrize('encoder', ['dlsc_qbs', 'dlsc_qbs_paper', 'dlsc'])
    def test_the_name_of_a_row_says_what_ran_whatever_the_parameters_ask_for(
            self, pipeline, flight, tmp_path, encoder):
        for k, (mode, gate) in enumerate(product(('epochs', 'paper'), ('true', 'false'))):
            evaluate.main([str(flight), '--encoder', encoder, '--set', f'encoder.mode={mode}',
                           '--set', f'encoder.gate={gate}', '--out', str(tmp_path / str(k))])
        assert pipeline.encoded == 4 * [Config().override(METHODS[encoder].overrides)]

    def test_a_parameter_that_a_row_overrules_is_told_and_no_other(
            self, pipeline, flight, tmp_path, capsys):
        profile = tmp_path / 'profile.yaml'
        profile.write_text('/**:\n  ros__parameters:\n    encoder: {mode: paper, n_atoms: 9}\n')
        out = tmp_path / 'out'
        assert evaluate.main(
            [str(flight), '--encoder', 'dlsc_qbs,dlsc_qbs_paper,odometry', '--config',
             str(profile), '--set', 'encoder.gate=true', '--out', str(out)]) == 0
        assert capsys.readouterr().err == (
            "evaluate: encoder.mode = 'paper' has no effect on the row dlsc_qbs, "
            "which sets 'epochs'\n")
        assert "# rows of dlsc_qbs: encoder.mode = 'epochs'\n" in (
            out / 'config.yaml').read_text()

    def test_without_ground_truth_the_figures_are_null(self, pipeline, flight, tmp_path, capsys):
        pipeline.with_truth = False
        assert evaluate.main([str(flight), '--out', str(tmp_path / 'out')]) == 0
        row, = rows_of(tmp_path / 'out')
        assert row['mae_l'] is row['odometry_mae_m'] is row['alignment'] is None
        assert 'no ground truth' in capsys.readouterr().out

    def test_configuration_reads_back_as_it_was(self, pipeline, flight, tmp_path):
        profile = tmp_path / 'profile.yaml'
        profile.write_text('/**:\n  ros__parameters:\n    encoder: {n_atoms: 9, seed: 1}\n')
        evaluate.main([str(flight), '--config', str(profile), '--set', 'encoder.seed=2',
                       '--set', 'encoder.eta_c=1e-3', '--set', 'ratslam.threshold=0.6',
                       '--set', 'ratslam.tracking_threshold=0.43',
                       '--out', str(tmp_path / 'out')])
        read_back = Config().override(load_profile(tmp_path / 'out' / 'config.yaml'))
        assert read_back == pipeline.mapped[0]
        assert read_back == Config().override({
            'encoder.n_atoms': 9, 'encoder.seed': 2, 'encoder.eta_c': 1e-3,
            'ratslam.threshold': 0.6,
            'ratslam.tracking_threshold': 0.43})
        assert '[]' not in (tmp_path / 'out' / 'config.yaml').read_text(), 'ROS cannot read []'

    def test_topics_reach_the_reader(self, pipeline, flight, tmp_path):
        evaluate.main([str(flight), '--image-topic', '/a', '--odom-topic', '/b',
                       '--ground-truth-topic', '/c', '--out', str(tmp_path / 'out')])
        assert pipeline.read == [(flight, '/a', '/b', '/c')]

    def test_a_log_of_a_link_and_which_autopilot_s_reach_the_reader(
            self, pipeline, flight, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        evaluate.main([str(flight), '--tlog', 'link.tlog', '--set', 'mavlink.system=3',
                       '--out', 'out'])
        assert pipeline.links == [(tmp_path / 'link.tlog', MavlinkConfig(system=3))]

    def test_a_flight_whose_whole_name_is_the_ending_keeps_it(self, pipeline, tmp_path):
        (tmp_path / '.mcap').touch()
        assert evaluate.main([str(tmp_path / '.mcap'), '--out', str(tmp_path / 'out')]) == 0
        assert [row['flight'] for row in rows_of(tmp_path / 'out')] == ['.mcap']

    def test_flights_of_one_name_are_told_apart_by_their_folders(self, pipeline, tmp_path):
        for folder in ('seed_0', 'seed_1'):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / 'flight_1.mcap').touch()
        out = tmp_path / 'out'
        evaluate.main([str(tmp_path / folder / 'flight_1.mcap') for folder in ('seed_0', 'seed_1')]
                      + ['--out', str(out)])
        assert [row['flight'] for row in rows_of(out)] == ['seed_0_flight_1', 'seed_1_flight_1']


class TestThreshold:
    """A number for all rows, or the best one for each."""

    def test_a_number_is_used_and_reported(self, pipeline, flight, tmp_path):
        evaluate.main([str(flight), '--threshold', '0.7', '--out', str(tmp_path / 'out')])
        row, = rows_of(tmp_path / 'out')
        assert (row['threshold'], row['threshold_tuned']) == (0.7, False)
        assert row['mae_l'] == pytest.approx(0.0, abs=1e-6)

    def test_tune_finds_the_least_mae_l_and_maps_each_mu_once(
            self, pipeline, flight, tmp_path):
        evaluate.main([str(flight), '--threshold', 'tune', '--out', str(tmp_path / 'out')])
        row, = rows_of(tmp_path / 'out')
        assert row['threshold_tuned'] is True
        assert row['threshold'] == min(METHODS['dlsc_qbs'].grid, key=lambda mu: abs(mu - 0.7))
        assert len(pipeline.encoded) == 1
        assert len(pipeline.mapped) == len(METHODS['dlsc_qbs'].grid)

    def test_mu_of_a_distance_is_given_and_reported_as_one(self, pipeline, flight, tmp_path):
        pipeline.best = 0.04
        for k, threshold in enumerate((['--threshold', '0.07'], ['--threshold', 'tune'], [])):
            evaluate.main([str(flight), '--encoder', 'ratslam', *threshold, '--out',
                           str(tmp_path / str(k))])
        given, tuned, usual = (rows_of(tmp_path / str(k))[0]['threshold'] for k in range(3))
        assert (given, tuned, usual) == (0.07, 0.04, METHODS['ratslam'].threshold)
        # The back end takes it with a minus sign: it grows with likeness.
        assert pipeline.mapped[0].ratslam.threshold == -0.07

    def test_mu_while_tracking_moves_along(self, pipeline, flight, tmp_path):
        usual = Config().ratslam
        for row in ('dlsc_qbs', 'ratslam'):
            evaluate.main([str(flight), '--encoder', row, '--threshold', '0.07', '--out',
                           str(tmp_path / row)])
        similarity, distance = (config.ratslam for config in pipeline.mapped)
        assert similarity.tracking_threshold - similarity.threshold == pytest.approx(
            usual.tracking_threshold - usual.threshold)
        assert distance.tracking_threshold - distance.threshold == pytest.approx(
            -METHODS['ratslam'].tracking_gap)

    def test_tune_takes_the_strictest_of_equals(
            self, pipeline, flight, tmp_path, monkeypatch):
        monkeypatch.setattr(job, 'map_codes', lambda encoded, config, measure: pipeline.map_codes(
            encoded, config.override({'ratslam.threshold': 0.7}), measure))
        evaluate.main([str(flight), '--threshold', 'tune', '--out', str(tmp_path / 'out')])
        assert rows_of(tmp_path / 'out')[0]['threshold'] == max(METHODS['dlsc_qbs'].grid)

    def test_tune_leaves_odometry_alone(self, pipeline, flight, tmp_path):
        evaluate.main([str(flight), '--encoder', 'odometry', '--threshold', 'tune', '--out',
                       str(tmp_path / 'out')])
        row, = rows_of(tmp_path / 'out')
        assert (row['threshold'], row['threshold_tuned']) == (None, False)

    def test_tune_needs_ground_truth(self, pipeline, flight, tmp_path, capsys):
        pipeline.with_truth = False
        assert evaluate.main([str(flight), '--threshold', 'tune', '--out',
                              str(tmp_path / 'out')]) == 1
        assert 'flight_1.mcap: --threshold tune: expected ground truth' in capsys.readouterr().err


class TestRefusals:
    """Expected errors are one line on stderr and exit code 1."""

    @pytest.mark.parametrize('arguments, message', [
        (['--encoder', 'dlsc,vgg'], "--encoder 'vgg': expected any of odometry, oracle, ratslam"),
        (['--encoder', ''], "--encoder ''"),
        (['--encoder', 'vgg11'], '--encoder vgg11: expected --onnx vgg11=FILE'),
        (['--encoder', 'vgg11', '--onnx', 'a.onnx'], 'expected --onnx vgg11=FILE'),
        (['--onnx', 'hog=a.onnx'], "--onnx 'hog=a.onnx': the encoder hog has no network"),
        (['--set', 'encoder.atoms=3'], "unknown parameter 'encoder.atoms' (value 3)"),
        (['--set', 'encoder.n_atoms=0'], 'encoder.n_atoms = 0: expected a value in [1, 4096]'),
        (['--set', 'encoder.n_atoms'], "'encoder.n_atoms': expected section.name=value"),
        (['--set', 'encoder.eta_c=fast'], "encoder.eta_c = 'fast': expected float"),
        (['--threshold', 'best'], "--threshold 'best': expected a number or 'tune'"),
        (['--threshold', '1.5'], 'ratslam.threshold = 1.5: expected a value in [-1.0, 1.0]'),
        (['--threshold', 'nan'], 'ratslam.threshold = nan'),
        (['--config', 'absent.yaml'], 'absent.yaml: not a readable YAML file'),
    ])
    def test_of_arguments(self, pipeline, flight, tmp_path, capsys, arguments, message):
        assert evaluate.main([str(flight), *arguments, '--out', str(tmp_path / 'out')]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.startswith('evaluate: ')
        assert error.count('\n') == 1
        assert pipeline.read == []

    def test_of_a_missing_flight_before_any_work(self, pipeline, flight, tmp_path, capsys):
        absent = tmp_path / 'absent.mcap'
        assert evaluate.main([str(flight), str(absent), '--out', str(tmp_path / 'out')]) == 1
        assert capsys.readouterr().err == f'evaluate: {absent}: no such file or folder\n'
        assert pipeline.read == []

    def test_of_a_broken_flight_keeps_the_rows_before_it(
            self, pipeline, flight, tmp_path, capsys):
        broken = tmp_path / 'broken.mcap'
        broken.write_text('not a recording')
        out = tmp_path / 'out'
        assert evaluate.main([str(flight), str(broken), '--out', str(out)]) == 1
        assert capsys.readouterr().err == f'evaluate: {broken}: not an MCAP file\n'
        assert [row['flight'] for row in rows_of(out)] == ['flight_1']

    def test_of_a_flight_whose_frames_meet_no_odometry(
            self, pipeline, flight, tmp_path, capsys):
        pipeline.usable = slice(0)
        assert evaluate.main([str(flight), '--out', str(tmp_path / 'out')]) == 1
        assert 'flight_1.mcap: expected odometry before and after' in capsys.readouterr().err

    def test_of_a_flight_given_twice(self, pipeline, flight, tmp_path, capsys):
        assert evaluate.main([str(flight), str(flight), '--out', str(tmp_path / 'out')]) == 1
        assert 'given twice' in capsys.readouterr().err

    def test_of_an_output_folder_that_is_a_file(self, pipeline, flight, capsys):
        assert evaluate.main([str(flight), '--out', str(flight)]) == 1
        error = capsys.readouterr().err
        assert f'--out {flight}: cannot be written' in error
        assert error.count('\n') == 1

    @pytest.mark.parametrize('name', ['config.yaml', 'metrics.json', 'flight_1_dlsc_qbs.png'])
    def test_of_a_result_that_cannot_be_written(self, pipeline, flight, tmp_path, capsys, name):
        out = tmp_path / 'out'
        (out / name).mkdir(parents=True)
        assert evaluate.main([str(flight), '--out', str(out)]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f'evaluate: --out {out}: cannot be written: ')
        assert name in error
        assert error.count('\n') == 1

    def test_of_the_root_folder(self, pipeline, tmp_path, capsys):
        assert evaluate.main(['/', '--out', str(tmp_path / 'out')]) == 1
        assert capsys.readouterr().err == (
            'evaluate: /: expected an MCAP file or a rosbag2 folder\n')

    def test_of_a_command_line_without_a_flight(self, capsys):
        with pytest.raises(SystemExit) as exit_:
            evaluate.main(['--out', 'out'])
        assert exit_.value.code == 2
        assert 'FLIGHT' in capsys.readouterr().err


def test_the_command_needs_neither_ros_nor_matplotlib_to_start():
    code = ('import sys, dlsc_qbs_ros.cli.evaluate\n'
            'print([m for m in ("rclpy", "sensor_msgs", "nav_msgs", "matplotlib") '
            'if m in sys.modules])')
    output = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True,
                            text=True, timeout=60).stdout
    assert output.strip() == '[]'
