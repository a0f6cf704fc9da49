"""The same work on many items: one after the other, in processes of this machine, or on a cluster by Dask.

The work is a function of a module, and with its items goes to where it is done by pickle. Results come as they are
done, each with the number of its item; `in_order` puts them back. An error of the work is raised here.
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
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext, ForkContext, ForkServerContext, SpawnContext
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from studies.extras import installation

Item = TypeVar("Item")
Result = TypeVar("Result")

ENDED = "a process was ended from outside, perhaps for want of memory; take fewer --jobs: completed work is kept"
TIMEOUT = 30.0  # s, after which a scheduler that does not answer is said not to


class WorkersError(RuntimeError):
    """Workers that cannot be had, or that are gone."""


def nothing(item: object) -> None:
    """Make nothing before the work."""


class Workers(Protocol):
    """Who does the work."""

    def done(
        self, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of an item and its result, in the order of completion; `first` makes the parts that items
        share, and caches them in its process."""


@dataclass(frozen=True)
class InTurn:
    """This process, one item after the other."""

    def done(
        self, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of an item and the result of the work on it, in their order."""
        for number, item in enumerate(items):
            yield number, _alone(work, item)


@dataclass(frozen=True)
class Processes:
    """So many processes of this machine."""

    jobs: int

    def done(
        self, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of an item and the result of the work on it, as they are done.

        Items are handed out in runs of neighbours, one run to a process: neighbours share what is expensive to make.
        Where processes are forks, they are those of one that leads them: what `first` makes of the first item is made
        there once, for all of them.
        """
        if not items:
            return
        context = context_of(work.__module__)
        if context.get_start_method() == "spawn":
            yield from _pooled(context, self.jobs, work, items)
            return
        results, theirs = context.Pipe(duplex=False)
        leader = context.Process(target=_lead, args=(theirs, self.jobs, work, items, first))
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
    """Make what is shared, and send the results of processes that are forks of this one, each with its number, or an
    error. No thread of this process runs before it forks, so the system ends it with its parent, by whose lock on a
    folder it would else keep the next one out."""
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
    """Yield results as they are done by so many processes, which end with the one that asks for them."""
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
    """Return how a process begins: on Linux as a fork of this one, which has imported all that is needed, or, where
    this one has threads, a fork of which may lock up, of one that does nothing but import the `module` of the work;
    elsewhere, where libraries bear no fork, anew.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    if len(os.listdir("/proc/self/task")) == 1:
        return multiprocessing.get_context("fork")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module])
    return context


def _begin() -> None:
    """Leave interrupts to the process that began this one, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := multiprocessing.parent_process()) is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


def _shares(count: int, jobs: int) -> list[list[int]]:
    """Return runs of neighbouring numbers below `count`, as many as there are jobs, the last item of each first."""
    bounds = [count * k // jobs for k in range(jobs + 1)]
    return [list(range(low, high))[::-1] for low, high in pairwise(bounds) if high > low]


def _handed_out(
    pool: ProcessPoolExecutor, work: Callable[[Item], Result], shares: list[list[int]], items: Sequence[Item]
) -> Iterator[tuple[int, Result]]:
    """Keep one item of each share at work; a share that is done takes over half of the longest that is left."""
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


@dataclass(frozen=True)
class Cluster:
    """The workers of a Dask scheduler at an address, such as ``tcp://10.0.0.1:8786``."""

    address: str

    def done(
        self, work: Callable[[Item], Result], items: Sequence[Item], first: Callable[[Item], object] = nothing
    ) -> Iterator[tuple[int, Result]]:
        """Yield the number of an item and the result of the work on it, as they are done."""
        distributed = _distributed()
        with _client(distributed, self.address) as client:
            futures = client.map(_on_cluster, [(work, item) for item in items], pure=False)
            numbers = {future.key: number for number, future in enumerate(futures)}
            try:
                for future in distributed.as_completed(futures):
                    yield numbers[future.key], future.result()
            except distributed.KilledWorker as error:
                raise WorkersError(f"workers of the cluster are gone ({error}); completed work is kept") from None
            finally:
                client.cancel(futures)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise WorkersError(f"--dask is refused: distributed is not installed; {installation('distributed')}") from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    try:
        return distributed.Client(address, timeout=TIMEOUT)
    except (OSError, ValueError) as error:
        reason = f"no scheduler answers there ({error}); start one by dask scheduler, or take --jobs"
        raise WorkersError(f"--dask {address} is refused: {reason}") from None


def _on_cluster(pair: tuple[Callable[[Item], Result], Item]) -> Result:
    return _alone(*pair)


def _alone(work: Callable[[Item], Result], item: Item) -> Result:
    """Do the work with one thread of BLAS: beside others, and to the same bits wherever it is done."""
    with threadpool_limits(limits=1, user_api="blas"):
        return work(item)


def workers_of(jobs: int = 1, address: str | None = None) -> Workers:
    """Return the cluster at an address, else so many processes; one is this process itself."""
    if address is not None:
        return Cluster(address)
    return InTurn() if jobs == 1 else Processes(jobs)


def in_order(done: Iterable[tuple[int, Result]]) -> Iterator[Result]:
    """Yield results in the order of their items, each as soon as all before it are done."""
    waiting: dict[int, Result] = {}
    following = 0
    for number, result in done:
        waiting[number] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1
