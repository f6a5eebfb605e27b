"""The reproduce command and its report: every row, on every flight, in one page."""

from base64 import b64decode
from functools import lru_cache
from html.parser import HTMLParser
import json
import re
import sys

from dlsc_qbs_ros.cli import reproduce
from dlsc_qbs_ros.cli.job import TUNE
from dlsc_qbs_ros.cli.methods import METHODS
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import GroundTruthSample, Pose2
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.evaluation import report
from dlsc_qbs_ros.evaluation.metrics import evaluate_run
from dlsc_qbs_ros.evaluation.paper_table import (
    contests, kind_of, mean_errors, PAPER, paper_errors)
from dlsc_qbs_ros.evaluation.place_recognition import Recognition
from dlsc_qbs_ros.evaluation.table import Outcome, Row, Run
from dlsc_qbs_ros.pipeline.runner import RunResult
from dlsc_qbs_ros.profiles import load_profile
import numpy as np
import pytest

SECOND_NS = 10**9
N = 30
COUNTS = {'frames': N, 'view_cells': 5, 'experiences': N, 'closures': 1, 'learning_frames': 3,
          'epochs': 2}
WITHOUT_NETWORKS = [name for name, method in METHODS.items() if not method.has_network]


@lru_cache(maxsize=None)
def row_of(flight, encoder, error_m, tuned=False):
    """Return a run that is off by about so much."""
    walk = np.random.default_rng(len(flight)).normal(size=(N, 2)).cumsum(axis=0)
    truth = [GroundTruthSample(k * SECOND_NS, Pose2(*position, 0.0))
             for k, position in enumerate(walk.tolist())]
    poses = np.column_stack([walk, np.zeros(N)])
    poses[::2, 0] += error_m
    poses[1::2, 0] -= error_m
    result = RunResult(
        np.arange(N, dtype=np.int64) * SECOND_NS, poses, poses[:, :2], poses, poses, poses,
        np.arange(N),
        np.zeros((0, 2), np.int64), np.array([[0, 9]]), np.zeros((1, 3)),
        COUNTS, 0.1)
    threshold = 0.8 if METHODS[encoder].grid else None
    return Run(Row(flight, encoder, evaluate_run(result, truth), threshold, tuned, 0, N, COUNTS,
                   {}, 0.03, 0.06), result)


def outcome_of(job):
    """Stand in for a run: later rows are better, and each is better tuned."""
    rank = list(METHODS)[::-1].index(job.method) + 1
    runs = [row_of(job.flight.name, job.method, 0.1 * rank * (0.5 if mu == TUNE else 1.0),
                   mu == TUNE) for mu in job.thresholds]
    found = Recognition(np.array([1.0, 0.95]), np.array([0.4, 0.8]), 0.8, 5, 9)
    return Outcome(runs, found if METHODS[job.method].grid else None, None)


class Tools:
    """Stands in for the other tools and for the runs."""

    def __init__(self):
        self.simulated, self.trained, self.jobs, self.broken = [], [], [], None

    def simulate(self, argv):
        self.simulated.append(argv)
        out = argv[argv.index('--out') + 1]
        (reproduce.Path(out)).mkdir(parents=True)
        return 0

    def train(self, argv):
        self.trained.append(argv)
        return 0

    def run_job(self, job):
        if job.method == self.broken:
            raise RecordingError(f'{job.flight.path}: cut')
        self.jobs.append(job)
        return outcome_of(job)


@pytest.fixture
def tools(monkeypatch):
    """Put the stand-in in the place of everything slow; there is no PyTorch."""
    for name in ('trajectories', 'precision_recall'):
        monkeypatch.setattr(report, name, lambda outcomes: b'')
    return put_in(monkeypatch)


def put_in(monkeypatch):
    fake = Tools()
    monkeypatch.setattr(reproduce.simulate, 'main', fake.simulate)
    monkeypatch.setattr(reproduce.train_latentslam, 'main', fake.train)
    monkeypatch.setattr(reproduce, 'run_job', fake.run_job)
    monkeypatch.setattr(reproduce, 'spread', lambda work, jobs, *_: map(work, jobs))
    monkeypatch.setattr(reproduce, 'find_spec', lambda name: None)
    return fake


def document_of(out):
    return json.loads((out / 'report.json').read_text())


class Page(HTMLParser):
    """Reads a page, refuses tags that do not pair, and collects text and references."""

    VOID = {'meta', 'img', 'br'}

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.references = [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.references += [value for name, value in attrs if name in ('src', 'href')]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


class TestFlights:
    """Where the flights come from."""

    def test_three_are_made_for_each_seed(self, tools, tmp_path):
        assert reproduce.main(['--seeds', '4', '7', '--out', str(tmp_path / 'out')]) == 0
        made = [(argv[1], argv[3]) for argv in tools.simulated]
        assert made == [(kind, seed) for seed in '47' for kind in '123']
        rows = document_of(tmp_path / 'out')['rows']
        assert {row['flight'] for row in rows} == {
            f'flight{kind}_seed{seed}' for seed in '47' for kind in '123'}

    def test_those_that_are_there_are_taken(self, tools, tmp_path):
        for _ in range(2):
            assert reproduce.main(['--out', str(tmp_path / 'out')]) == 0
        assert len(tools.simulated) == 3

    def test_one_that_was_broken_off_is_made_again(self, tools, tmp_path, monkeypatch):
        def broken_off(argv):
            tools.simulate(argv)
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(reproduce.simulate, 'main', broken_off)
            assert reproduce.main(['--out', str(tmp_path / 'out')]) != 0
        assert list((tmp_path / 'out' / 'flights').iterdir()) == []
        assert reproduce.main(['--out', str(tmp_path / 'out')]) == 0
        assert len(tools.simulated) == 1 + 3

    def test_where_they_cannot_be_written_is_told(self, tools, tmp_path, capsys):
        (tmp_path / 'flights').touch()
        assert reproduce.main(['--out', str(tmp_path)]) == 1
        assert f'--out {tmp_path / "flights"}: cannot be written' in capsys.readouterr().err

    def test_given_ones_are_taken_instead(self, tools, tmp_path):
        (tmp_path / 'walk.mcap').touch()
        assert reproduce.main(['--flights', str(tmp_path / 'walk.mcap'), '--odom-topic', '/o',
                               '--out', str(tmp_path / 'out')]) == 0
        assert tools.simulated == []
        assert {(job.flight.name, job.flight.odom_topic) for job in tools.jobs} == {
            ('walk', '/o')}


class TestRows:
    """What runs on each flight."""

    def test_every_row_at_its_own_mu_and_tuned_from_one_encoding(self, tools, tmp_path):
        reproduce.main(['--out', str(tmp_path / 'out')])
        assert {job.thresholds for job in tools.jobs if METHODS[job.method].grid} == {
            (None, TUNE)}
        document = document_of(tmp_path / 'out')
        for rows in (document['rows'], document['rows_tuned']):
            assert [row['encoder'] for row in rows] == 3 * WITHOUT_NETWORKS
        assert not any(row['threshold_tuned'] for row in document['rows'])
        assert all(row['threshold_tuned'] for row in document['rows_tuned']
                   if row['encoder'] != 'odometry')

    def test_rows_of_one_meaning_run_once_and_stand_twice(self, tools, tmp_path):
        reproduce.main(['--out', str(tmp_path / 'out')])
        same = document_of(tmp_path / 'out')['same']
        assert same == {'image_no_gate': 'dlsc', 'dlsc_qbs': 'dlsc_qbs_patches'}
        assert len(tools.jobs) == 3 * (len(WITHOUT_NETWORKS) - len(same))

    def test_the_default_row_stands_for_what_the_configuration_says(self, tools, tmp_path):
        reproduce.main(['--set', 'encoder.input=image', '--out', str(tmp_path / 'out')])
        assert document_of(tmp_path / 'out')['same']['dlsc_qbs'] == 'dlsc_qbs_image'

    def test_networks_are_run_where_they_are_given(self, tools, tmp_path):
        out = tmp_path / 'out'
        reproduce.main(['--onnx', 'vgg11=v.onnx', '--onnx', 'mine.onnx', '--out', str(out)])
        networks = {job.method: job.network for job in tools.jobs if job.network}
        assert {name: path.name for name, path in networks.items()} == {
            'vgg11': 'v.onnx', 'onnx': 'mine.onnx'}
        assert list(document_of(out)['left_out']) == ['latentslam']

    def test_latentslam_is_trained_on_flights_that_are_not_evaluated(
            self, tools, tmp_path, monkeypatch):
        monkeypatch.setattr(reproduce, 'find_spec', lambda name: True)
        out = tmp_path / 'out'
        assert reproduce.main(['--seeds', '2', '5', '--out', str(out)]) == 0
        argv, = tools.trained
        trained = [name for name in argv if 'flight' in name]
        assert trained == [str(out / 'flights' / f'flight{kind}_seed6') for kind in '123']
        assert {job.network for job in tools.jobs if job.method == 'latentslam'} == {
            out / 'latentslam.onnx'}
        facts = document_of(out)['facts']
        assert facts['LatentSLAM trained on'] == ', '.join(
            f'flight{kind}_seed6' for kind in '123')
        assert 'PyTorch' in facts
        assert {job.flight.name for job in tools.jobs}.isdisjoint(
            {f'flight{kind}_seed6' for kind in '123'})

    def test_a_flight_for_training_and_evaluation_is_refused(
            self, tools, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr(reproduce, 'find_spec', lambda name: True)
        for name in 'ab':
            (tmp_path / name).mkdir()
        assert reproduce.main(['--flights', str(tmp_path / 'a'), '--training', str(tmp_path / 'b'),
                               str(tmp_path / 'b' / '..' / 'a'),
                               '--out', str(tmp_path / 'out')]) == 1
        assert (f'{tmp_path / "a"}: expected LatentSLAM to be trained on flights other than those '
                'evaluated' in capsys.readouterr().err)
        assert tools.trained == tools.jobs == []

    def test_a_broken_flight_leaves_a_report_of_the_rows_before_it(
            self, tools, tmp_path, capsys):
        tools.broken = 'thumbnail'
        assert reproduce.main(['--out', str(tmp_path / 'out')]) == 1
        assert capsys.readouterr().err.endswith('flight1_seed0: cut\n')
        assert [row['encoder'] for row in document_of(tmp_path / 'out')['rows']] == [
            'odometry', 'oracle', 'ratslam', 'orb']

    def test_without_matplotlib_it_ends_before_any_work(
            self, tools, tmp_path, monkeypatch, capsys):
        monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
        assert reproduce.main(['--out', str(tmp_path / 'out')]) == 1
        assert 'report.html: pictures need matplotlib' in capsys.readouterr().err
        assert tools.simulated == tools.jobs == []

    def test_a_flight_that_cannot_be_made_is_an_error(self, tools, tmp_path, monkeypatch, capsys):
        monkeypatch.setattr(reproduce.simulate, 'main', lambda argv: 1)
        assert reproduce.main(['--out', str(tmp_path / 'out')]) == 1
        assert 'flight1_seed0: could not be made' in capsys.readouterr().err


@pytest.fixture(scope='module')
def out(tmp_path_factory):
    """Return the folder of one run whose pictures are drawn."""
    folder = tmp_path_factory.mktemp('report') / 'out'
    with pytest.MonkeyPatch.context() as patch:
        put_in(patch)
        assert reproduce.main(['--set', 'encoder.seed=3', '--out', str(folder)]) == 0
    return folder


class TestReport:
    """The page and its numbers."""

    def test_the_page_is_whole_and_needs_nothing_else(self, out):
        page = Page((out / 'report.html').read_text())
        assert len(page.references) == 6  # trajectories, precision and recall of three flights
        for reference in page.references:
            kind, _, data = reference.partition(',')
            assert kind == 'data:image/png;base64'
            assert b64decode(data).startswith(b'\x89PNG')
        assert 'http' not in (out / 'report.html').read_text().replace('data:', '')

    def test_it_tells_the_paper_s_numbers_beside_ours(self, out):
        text = ' '.join(Page((out / 'report.html').read_text()).text)
        for flights in PAPER.values():
            for errors in flights:
                assert f'{errors.mae_l:.3f} | {errors.mae_m:.3f}' in text

    def test_it_tells_what_was_left_out_and_why(self, out):
        text = ' '.join(Page((out / 'report.html').read_text()).text)
        assert re.search(r'Left out: latentslam: .*extra \[train\]: no torch, onnx', text)
        assert 'Left out: vgg11: its weights are given by --onnx vgg11=FILE' in text

    def test_it_tells_versions_seeds_and_configuration(self, out):
        document = document_of(out)
        assert document['config'] == json.loads(json.dumps(
            Config().override({'encoder.seed': 3}).flat()))
        assert Config().override(load_profile(out / 'config.yaml')) == Config().override(
            {'encoder.seed': 3})
        facts = document['facts']
        assert facts['NumPy'] == np.__version__
        assert facts['seeds of the flights'] == [0]
        assert facts['command'].startswith('reproduce --set encoder.seed=3')
        told = Page((out / 'report.html').read_text()).text
        assert {*map(str, facts), *Config().flat()} <= {*told}
        assert facts['NumPy'] in told

    def test_it_holds_ours_at_one_mu_against_the_others_tuned(self, out):
        document = document_of(out)
        first, *_ = document['contests']
        assert first['ours'] == next(
            row['mae_l'] for row in document['rows'] if row['encoder'] == 'dlsc_qbs')
        assert first['theirs'] == next(
            row['mae_l'] for row in document['rows_tuned'] if row['encoder'] == first['rival'])
        assert first['rival'] == 'patches_no_gate', 'the best but ours by either name'
        assert len(document['contests']) == 6

    def test_it_tells_cost_and_recognition_of_every_row(self, out):
        document = document_of(out)
        assert [row['encoder'] for row in document['timing']] == 3 * WITHOUT_NETWORKS
        assert {row['place_recognition']['r99'] for row in document['rows']
                if row['encoder'] != 'odometry'} == {0.4}

    def test_the_page_tells_the_cost_as_means_over_flights(self, out):
        told = Page((out / 'report.html').read_text()).text
        cost = told[told.index('encode [ms]'):told.index('Every run')]
        timing = document_of(out)['timing'][0]
        encode_ms, map_ms = timing['encode_ms_per_frame'], timing['map_ms_per_code']
        assert cost.count(f'{encode_ms:.2f}') == cost.count(f'{encode_ms + map_ms:.2f}') == len(
            WITHOUT_NETWORKS), 'the stand-ins cost the same on each flight'


class TestPaperTable:
    """Means, columns and the contest of our row with the others."""

    @pytest.mark.parametrize('name, kind', [
        ('flight1_seed0', 'Flight 1'), ('flight_3', 'Flight 3'), ('seed_1_flight_2', 'Flight 2'),
        ('flight2_pause_seed3', 'flight2_pause'), ('hololens_walk', 'hololens_walk'),
        ('flight12', 'flight12'), ('inflight1', 'inflight1')])
    def test_a_column_holds_the_seeds_of_one_kind(self, name, kind):
        assert kind_of(name) == kind

    def test_the_paper_has_numbers_for_its_own_rows_and_flights_only(self):
        assert paper_errors('orb', 'Flight 3') == (4.258, 1.595)
        assert paper_errors('hog', 'Flight 3') is None
        assert paper_errors('orb', 'walk') is None

    def test_errors_are_means_over_the_flights_of_a_kind(self):
        rows = [row_of(f'flight1_seed{seed}', 'hog', error_m).row
                for seed, error_m in enumerate((0.2, 0.4))]
        errors = mean_errors(rows)
        assert list(errors) == [('hog', 'Flight 1')]
        assert errors['hog', 'Flight 1'].mae_l == pytest.approx(0.3)

    def test_ours_at_one_mu_is_held_against_the_best_of_the_others_tuned(self):
        def rows(**errors_m):
            return [row_of('flight1_seed0', name, error_m).row
                    for name, error_m in errors_m.items()]
        localisation, _ = contests(
            rows(dlsc_qbs=0.3, dlsc_qbs_patches=0.3, hog=0.9, orb=0.8, oracle=0.2),
            rows(dlsc_qbs=0.1, dlsc_qbs_patches=0.1, hog=0.5, orb=0.4, oracle=0.1),
            ['dlsc_qbs_patches'])
        assert localisation[:2] == ('Flight 1', 'MAE_L')
        assert localisation.ours == pytest.approx(0.3)
        assert (localisation.rival, localisation.theirs) == ('orb', pytest.approx(0.4))
        assert localisation.oracle == pytest.approx(0.2)
        assert localisation.is_won

    def test_a_flight_without_ground_truth_has_no_place_in_it(self):
        row = row_of('walk', 'hog', 0.2).row
        assert mean_errors([Row(**{**vars(row), 'metrics': None})]) == {}
