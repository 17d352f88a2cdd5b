"""How many passes of a loop stand for a piece of work, so that every thread has some of it."""

from __future__ import annotations

import pytest

from moteslam.kernels import runtime


@pytest.mark.parametrize("threads", [2, 3, 16])
def test_a_loop_over_few_pieces_of_work_is_long_enough_for_all_threads(
    monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """Each piece is in a batch of its own where there are few; a loop that is long enough stays as it is."""
    monkeypatch.setattr(runtime, "_runtime", runtime.Runtime("cpu", threads, False, None))
    few, some, many = 5, 40 * threads, 10_000 * threads
    assert runtime.passes_for(few) == runtime.BATCH
    assert some * runtime.passes_for(some) >= runtime.BATCH * runtime.BATCHES * threads
    assert some * (runtime.passes_for(some) - 1) < runtime.BATCH * runtime.BATCHES * threads
    assert runtime.passes_for(many) == 1
    assert runtime.passes_for(0) == 1


@pytest.mark.parametrize(("arch", "threads"), [("cpu", 1), ("cuda", 8)])
def test_one_thread_and_a_gpu_need_no_more_passes(monkeypatch: pytest.MonkeyPatch, arch: str, threads: int) -> None:
    monkeypatch.setattr(runtime, "_runtime", runtime.Runtime(arch, threads, False, None))
    assert runtime.passes_for(5) == 1
