"""Jobs over processes and over a cluster: the same results, byte for byte, whatever dies."""

from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from dlsc_qbs_ros.cli.job import Flight, Job, run_job
from dlsc_qbs_ros.cli.spread import ONE_THREAD, spread
from dlsc_qbs_ros.core.types import GroundTruthSample
from dlsc_qbs_ros.errors import ConfigError, DlscQbsError, RecordingError
from loop_flight import CONFIG, events, LAP_S, pose_at, stamp_ns
import numpy as np
import pytest

PATIENCE_S = 60.0
ROWS = ('odometry', 'thumbnail', 'dlsc_qbs_image', 'dlsc_qbs_paper')

needs_cluster = pytest.mark.skipif(
    find_spec('distributed') is None, reason='the extra [cluster] is not installed')


@dataclass(frozen=True)
class LoopFlight(Flight):
    """Two laps round the circle of `loop_flight`, with ground truth, out of no file."""

    seed: int = 0

    def events(self, refused=None, mavlink=None):
        truth = [GroundTruthSample(stamp_ns(t), pose_at(t))
                 for t in np.arange(0.0, 2.0 * LAP_S, 0.5).tolist()]
        return [*truth, *events(2.0 * LAP_S, self.seed)]


@dataclass(frozen=True)
class DeadlyFlight(LoopFlight):
    """The same; who reads it first is killed half-way."""

    marker: Path = Path()

    def events(self, refused=None, mavlink=None):
        whole = super().events()
        yield from whole[:len(whole) // 2]
        if not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        yield from whole[len(whole) // 2:]


def jobs():
    return [Job(LoopFlight(f'loop_{seed}', Path(f'loop_{seed}'), seed=seed), row, CONFIG)
            for seed in (1, 2) for row in ROWS]


def content(outcomes):
    """Return all that a report is made of, as bytes."""
    return [(json.dumps(outcome.as_json(outcome.runs[0])),
             outcome.runs[0].result.poses.tobytes(),
             outcome.runs[0].result.final_poses.tobytes()) for outcome in outcomes]


@pytest.fixture(scope='module')
def alone():
    """Return what one process makes of the jobs."""
    return content(spread(run_job, jobs()))


def wait_for(condition):
    """Wait until something holds, within reason."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f'nothing within {PATIENCE_S} s')
        time.sleep(0.02)


def first_ends_last(task):
    """Let the first job end after the second."""
    number, folder = task
    if number == 0:
        wait_for((folder / '1').exists)
    (folder / str(number)).touch()
    return number, os.getpid()


def environment(_):
    return {name: os.environ.get(name) for name in ONE_THREAD}


def first_then_wait(number):
    """Let the first job end, and no other within any patience."""
    wait_for(lambda: number == 0)
    return number


def refuse(number):
    if number == 1:
        raise RecordingError(f'flight {number}: cut')
    return number


def die(number):
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


class TestProcesses:
    """Processes of this machine."""

    def test_two_give_what_one_gives_byte_for_byte(self, alone):
        assert content(spread(run_job, jobs(), 2)) == alone

    def test_rows_have_met_their_places(self, alone):
        rows = [json.loads(row) for row, *_ in alone]
        assert [(row['flight'], row['encoder']) for row in rows] == [
            (f'loop_{seed}', encoder) for seed in (1, 2) for encoder in ROWS]
        assert all((row['closures'] > 0) == (row['encoder'] != 'odometry') for row in rows
                   if row['encoder'] in ('odometry', 'thumbnail'))

    def test_results_come_in_the_order_of_the_jobs(self, tmp_path):
        numbers, processes = zip(*spread(
            first_ends_last, [(number, tmp_path) for number in range(5)], 2))
        assert numbers == (0, 1, 2, 3, 4)
        assert os.getpid() not in processes

    def test_each_has_one_thread_and_this_one_keeps_its_own(self, monkeypatch):
        name = next(iter(ONE_THREAD))
        monkeypatch.setenv(name, '7')
        assert list(spread(environment, [0])) == [ONE_THREAD]
        assert os.environ[name] == '7'

    def test_an_error_comes_after_what_was_done_before_it(self):
        results = spread(refuse, range(3), 2)
        assert next(results) == 0
        with pytest.raises(RecordingError, match='flight 1: cut'):
            next(results)

    def test_a_process_that_dies_is_told(self):
        with pytest.raises(DlscQbsError, match='a process died, perhaps of a lack of memory'):
            list(spread(die, [1, 0]))

    def test_nothing_to_do_takes_no_process(self):
        assert list(spread(die, [])) == []

    def test_at_least_one_is_needed(self):
        with pytest.raises(ConfigError, match='--jobs 0: expected at least 1'):
            spread(refuse, [0], 0)


@contextmanager
def started(folder, n_workers, **environment):
    """Start a scheduler and workers, each a process; yield the address and the scheduler."""
    file = folder / 'scheduler.json'
    here = Path(__file__).parent
    env = {**os.environ, **ONE_THREAD, **environment, 'PYTHONPATH': os.pathsep.join(
        [str(here), str(here.parent), *filter(None, [os.environ.get('PYTHONPATH')])])}

    def start(tool, *arguments):
        return subprocess.Popen(
            [sys.executable, '-m', f'distributed.cli.{tool}', '--scheduler-file', str(file),
             '--no-dashboard', *arguments], env=env, cwd=folder, stdout=subprocess.DEVNULL,
            stderr=(folder / f'{tool}.log').open('a'))

    processes = [start('dask_scheduler', '--host', '127.0.0.1', '--port', '0')]
    try:
        processes += [
            start('dask_worker', '--nthreads', '1', '--no-nanny') for _ in range(n_workers)]
        yield address_in(file), processes[0]
    finally:
        for process in processes:
            process.kill()
            process.wait(PATIENCE_S)


@pytest.fixture(scope='module')
def cluster(tmp_path_factory):
    """Start three workers; yield the address of their scheduler."""
    with started(tmp_path_factory.mktemp('cluster'), 3) as (address, _):
        yield address


def address_in(file):
    """Return the address that a scheduler writes into a file, once it is whole."""
    wait_for(lambda: file.exists() and file.read_text().endswith('}'))
    return json.loads(file.read_text())['address']


@needs_cluster
class TestCluster:
    """Separate workers under a Dask scheduler."""

    def test_gives_what_one_process_gives_though_a_worker_is_killed_half_way(
            self, cluster, alone, tmp_path):
        marker = tmp_path / 'killed'
        deadly = jobs()
        flight = deadly[4].flight
        deadly[4] = replace(deadly[4], flight=DeadlyFlight(
            flight.name, flight.path, seed=flight.seed, marker=marker))
        assert content(spread(run_job, deadly, scheduler=cluster)) == alone
        assert marker.exists()

    def test_an_error_is_the_same_as_here(self, cluster):
        with pytest.raises(RecordingError, match='flight 1: cut'):
            list(spread(refuse, range(3), scheduler=cluster))

    def test_a_job_that_kills_its_worker_is_told(self, tmp_path):
        with (started(tmp_path, 1, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES='0')
              as (address, _), pytest.raises(DlscQbsError, match=(
                  f'--scheduler {address}: worker after worker died of one job'))):
            list(spread(die, [1], scheduler=address))

    def test_a_scheduler_that_is_lost_is_told(self, tmp_path):
        with started(tmp_path, 1) as (address, scheduler):
            results = spread(first_then_wait, [0, 1], scheduler=address)
            assert next(results) == 0
            scheduler.kill()
            with pytest.raises(DlscQbsError, match=f'{address}: the scheduler was lost'):
                next(results)

    def test_an_address_where_nobody_answers_is_told(self, monkeypatch):
        monkeypatch.setattr('dlsc_qbs_ros.cli.spread.CONNECT_S', 1.0)
        with pytest.raises(DlscQbsError, match='--scheduler tcp://127.0.0.1:9: no scheduler with'):
            list(spread(refuse, [0], scheduler='tcp://127.0.0.1:9'))


def test_without_the_extra_the_cluster_is_refused_with_a_word(monkeypatch):
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(DlscQbsError, match=r'--scheduler tcp://a:1: needs the extra \[cluster\]'):
        list(spread(refuse, [0], scheduler='tcp://a:1'))
