"""Work that several processes share, which take the GPUs of this machine in turn."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from warp_caustics.child_process import leave_ctrl_c_to_parent
from warp_caustics.errors import InputError, ResourceError

MAX_JOBS = 64
VISIBLE = "CUDA_VISIBLE_DEVICES"

Item = TypeVar("Item")
Result = TypeVar("Result")


def check_jobs(jobs: int) -> None:
    """Refuse a number of processes that nobody means.

    Raises:
        InputError: below 1 or above ``MAX_JOBS``.
    """
    if not 1 <= jobs <= MAX_JOBS:
        raise InputError(f"{jobs} jobs; give 1 to {MAX_JOBS}")


def in_processes(
    items: Sequence[Item],
    work: Callable[[Item], Result],
    start: Callable[[], None],
    jobs: int,
    gpus: Sequence[str] = (),
) -> Iterator[tuple[Item, Result]]:
    """Items with what came of them, in the order they end.

    Args:
        items: what to do.
        work: called in a process with one of them; a function of a module.
        start: called in each process first.
        jobs: how many.
        gpus: of :func:`gpus_for`; each process sees one of them, in turn. All see what this one does if empty.

    Raises:
        ResourceError: a process was killed.
        KeyboardInterrupt: Ctrl-C.
    """
    context = multiprocessing.get_context("spawn")
    count = min(jobs, len(items))
    pool = ProcessPoolExecutor(count, context, _begin, (context.Value("i", 0), tuple(gpus), count, start))
    try:
        futures = {pool.submit(_one, work, item): item for item in items}
        for future in as_completed(futures):
            yield futures[future], future.result()
        pool.shutdown()
    except BrokenProcessPool as error:
        raise ResourceError("a process was killed, perhaps for lack of memory; continue with fewer --jobs") from error
    except BaseException:
        # Whoever stops does not want to wait for what is running.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()
        raise


def _one(work: Callable[[Item], Result], item: Item) -> Result:
    import torch

    try:
        return work(item)
    finally:
        # What this process keeps for later, others of the same GPU lack now.
        if torch.cuda.is_initialized():
            torch.cuda.empty_cache()


def gpus_for(device: str) -> list[str]:
    """Names of all GPUs that this process sees, as ``CUDA_VISIBLE_DEVICES`` spells them, if it may take any.

    Args:
        device: as it was asked for: ``auto`` or ``cuda`` are all of them, ``cuda:1`` is that one, for which this is
            empty.
    """
    import torch

    if device not in ("auto", "cuda"):
        return []

    told = os.environ.get(VISIBLE)
    if told is not None:
        return [name for name in (name.strip() for name in told.split(",")) if name]
    return [str(number) for number in range(torch.cuda.device_count())]


def _begin(taken: Any, gpus: Sequence[str], count: int, start: Callable[[], None]) -> None:
    leave_ctrl_c_to_parent()
    with taken.get_lock():
        number, taken.value = taken.value, taken.value + 1
    if gpus:
        os.environ[VISIBLE] = gpus[number % len(gpus)]
    import torch

    # As many processes as there are, each with a thread for every core, would wait for each other.
    torch.set_num_threads(max(1, len(os.sched_getaffinity(0)) // count))
    start()
