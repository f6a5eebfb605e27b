"""Jobs over processes of this machine or of a Dask cluster: the same results, in order."""

from __future__ import annotations

from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
import multiprocessing
import os
from typing import Any, Callable, Iterator, Sequence

from ..errors import ConfigError, DlscQbsError

# Sums in several threads are rounded in another order, and processes would fight over the cores.
ONE_THREAD = {'OPENBLAS_NUM_THREADS': '1', 'MKL_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}
CONNECT_S = 30.0


def spread(work: Callable[[Any], Any], jobs: Sequence[Any], n_processes: int = 1,
           scheduler: str | None = None) -> Iterator[Any]:
    """
    Yield work(job) for each job, in their order, whatever order they are done in.

    Every job is done in a process of its own kind, single-threaded, also where there is but one,
    so that a result is the same to the last bit wherever it came from.

    Parameters
    ----------
    work : callable
        A function of a module; its argument and its result can be pickled.
    jobs : sequence
        Independent of each other.
    n_processes : int
        How many processes of this machine do them.
    scheduler : str, optional
        The address of a Dask scheduler, whose workers do them instead.

    Raises
    ------
    ConfigError
        When there is to be no process at all.
    DlscQbsError
        When a process dies, or no scheduler with workers answers; or whatever the work raised.

    """
    if n_processes < 1:
        raise ConfigError(f'--jobs {n_processes}: expected at least 1')
    if not jobs:
        return iter(())
    if scheduler is None:
        return _over_processes(work, jobs, min(n_processes, len(jobs)))
    return _over_cluster(work, jobs, scheduler)


def _over_processes(work: Callable[[Any], Any], jobs: Sequence[Any], n_processes: int
                    ) -> Iterator[Any]:
    context = multiprocessing.get_context('spawn')
    executor = ProcessPoolExecutor(n_processes, context)
    try:
        with _environment(ONE_THREAD):
            futures: list[Future] = [executor.submit(_alone, work, job) for job in jobs]
        for future in futures:
            yield future.result()
    except BrokenProcessPool as error:
        raise DlscQbsError('a process died, perhaps of a lack of memory: '
                           'fewer --jobs need less') from error
    except BaseException:
        for process in multiprocessing.active_children():
            process.terminate()  # nobody wants what it is at
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _alone(work: Callable[[Any], Any], job: Any) -> Any:
    """Do a job without further threads."""
    import cv2
    cv2.setNumThreads(1)
    return work(job)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Have variables set for the processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            del os.environ[name]
            if value is not None:
                os.environ[name] = value


def _over_cluster(work: Callable[[Any], Any], jobs: Sequence[Any], scheduler: str
                  ) -> Iterator[Any]:
    try:
        distributed = import_module('distributed')
    except ImportError as error:
        raise DlscQbsError(f'--scheduler {scheduler}: needs the extra [cluster]: {error}'
                           ) from error
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S)
        client.wait_for_workers(1, timeout=CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise DlscQbsError(f'--scheduler {scheduler}: no scheduler with workers answers: {error}'
                           ) from error
    with client:
        # What a worker that dies was doing, or had done, others do again.
        try:
            for future in client.map(_alone, [work] * len(jobs), jobs, pure=False):
                yield future.result()
        except distributed.KilledWorker as error:
            raise DlscQbsError(f'--scheduler {scheduler}: worker after worker died of one job, '
                               'perhaps of a lack of memory') from error
        except CancelledError as error:
            raise DlscQbsError(f'--scheduler {scheduler}: the scheduler was lost') from error
