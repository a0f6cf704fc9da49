"""The same work on many items, one after the other or at once.

It is done in this process, in processes of this machine, or on a cluster by Dask. The work is a
function of a module; pickle transfers the function and its items. Results are yielded in the order
of completion, each with the number of its item; `in_order` sorts them. An error of the work is
raised here.
"""

import ctypes
import multiprocessing.connection
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from itertools import pairwise
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext, ForkContext, ForkServerContext, SpawnContext
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from studies.extras import installation

Item = TypeVar("Item")
Result = TypeVar("Result")
# Does a work on items. It yields the number of an item and its result, in the order of completion.
# Before that, a third argument makes the parts that items share, and caches them in its process.
Workers = Callable[..., Iterator[tuple[int, Any]]]

ENDED = "a process was ended from outside, perhaps because memory ran out; use fewer --jobs: completed work is kept"
TIMEOUT = 30.0  # s, after which a scheduler counts as not answering


class WorkersError(RuntimeError):
    """Workers that are not available, or that have ended."""


def nothing(item: object) -> None:
    """Do nothing: no preparation of a work, or no report on its progress."""


def in_turn(
    work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
) -> Iterator[tuple[int, Result]]:
    """Yield the number of each item and its result in this process, one item after the other."""
    for number, item in enumerate(items):
        yield number, _alone(work, item)


def in_processes(
    jobs: int, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
) -> Iterator[tuple[int, Result]]:
    """Yield the results of `jobs` processes of this machine.

    Items are distributed in runs of neighbours, one run per process, because neighbours share
    expensive parts. If processes are forks, a leading process makes the shared parts once by
    `first` and then forks all of them.
    """
    if not items:
        return
    context = context_of(work.__module__)
    if context.get_start_method() == "spawn":
        yield from _pooled(context, jobs, work, items)
        return
    results, theirs = context.Pipe(duplex=False)
    leader = context.Process(target=_lead, args=(theirs, jobs, work, items, first))
    leader.start()
    theirs.close()
    try:
        for _ in items:
            number, result, error = results.recv()
            if error is not None:
                raise error
            yield number, result
        leader.join()
    except EOFError:
        raise WorkersError(ENDED) from None
    finally:
        results.close()
        leader.terminate()
        leader.join()


def _lead(
    results: Connection, jobs: int, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], Any]
) -> None:
    """Make the shared parts, and send the results of forked processes.

    Each result has its number, or is an error. No thread of this process runs before the fork. So
    the system can end the process with its parent; otherwise it would keep the lock on the folder.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG, see prctl(2)
    try:
        _alone(first, items[0])
        for number, result in _pooled(multiprocessing.get_context("fork"), jobs, work, items):
            results.send((number, result, None))
    except Exception as error:
        results.send((0, None, error))


def _pooled(
    context: BaseContext, jobs: int, work: Callable[[Item], Result], items: Sequence[Item]
) -> Iterator[tuple[int, Result]]:
    """Yield results in the order of completion from `jobs` processes.

    The processes end with the calling process.
    """
    with ProcessPoolExecutor(min(jobs, len(items)), context, _begin) as pool:
        try:
            pool.submit(nothing, None)  # forks all of them
            if multiprocessing.parent_process() is not None:
                _begin()
            yield from _handed_out(pool, work, _shares(len(items), jobs), items)
        except BrokenProcessPool:
            raise WorkersError(ENDED) from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def context_of(module: str) -> SpawnContext | ForkContext | ForkServerContext:
    """Return the context of new processes.

    On Linux it is a fork of this process, which has imported everything. If this process has
    threads, its fork could block, so a process that only imports the `module` of the work is
    forked. On other systems libraries do not support a fork, so new processes are started.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    if len(os.listdir("/proc/self/task")) == 1:
        return multiprocessing.get_context("fork")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module])
    return context


def _begin() -> None:
    """Ignore interrupts, which the parent process handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := multiprocessing.parent_process()) is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


def _shares(count: int, jobs: int) -> list[list[int]]:
    """Return runs of neighbouring numbers below `count`, one per job.

    Each run has its last number first.
    """
    bounds = [count * k // jobs for k in range(jobs + 1)]
    return [list(range(low, high))[::-1] for low, high in pairwise(bounds) if high > low]


def _handed_out(
    pool: ProcessPoolExecutor, work: Callable[[Item], Result], shares: list[list[int]], items: Sequence[Item]
) -> Iterator[tuple[int, Result]]:
    """Keep one item of each share at work.

    A finished share takes over half of the longest remaining share.
    """
    at_work = {pool.submit(_alone, work, items[first]): (first, share) for share in shares for first in [share.pop()]}
    while at_work:
        finished, _ = wait(at_work, return_when=FIRST_COMPLETED)
        for future in finished:
            number, share = at_work.pop(future)
            if not share:
                longest = max((other for _, other in at_work.values()), key=len, default=[])
                half = (len(longest) + 1) // 2
                share, longest[:half] = longest[:half], []
            if share:
                following = share.pop()
                at_work[pool.submit(_alone, work, items[following])] = (following, share)
            yield number, future.result()


def on_cluster(
    address: str, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
) -> Iterator[tuple[int, Result]]:
    """Yield the results of a Dask scheduler's workers.

    The scheduler is at an address, for example ``tcp://10.0.0.1:8786``.
    """
    try:
        import distributed
    except ImportError:
        raise WorkersError(f"--dask is refused: distributed is not installed; {installation('distributed')}") from None
    try:
        client = distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        reason = f"no scheduler answers ({error}); start one by dask scheduler, or use --jobs"
        raise WorkersError(f"--dask {address} is refused: {reason}") from None
    with client:
        futures = client.map(_alone, [work] * len(items), items, pure=False)
        numbers = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in distributed.as_completed(futures):
                yield numbers[future.key], future.result()
        except distributed.KilledWorker as error:
            raise WorkersError(f"workers of the cluster have ended ({error}); completed work is kept") from None
        finally:
            client.cancel(futures)


def _alone(work: Callable[[Item], Result], item: Item) -> Result:
    """Return the result of the work with one thread of BLAS.

    All processes then compute the same bits.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        return work(item)


def workers_of(jobs: int = 1, address: str | None = None) -> Workers:
    """Return the workers of the cluster at an address, or else `jobs` processes.

    For one job it is this process.
    """
    if address is not None:
        return partial(on_cluster, address)
    return in_turn if jobs == 1 else partial(in_processes, jobs)


def in_order(done: Iterable[tuple[int, Result]]) -> Iterator[Result]:
    """Yield results in the order of their items, each when all before it are done."""
    waiting: dict[int, Result] = {}
    following = 0
    for number, result in done:
        waiting[number] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1
