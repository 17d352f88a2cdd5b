"""Lets Python see as many processors as MOTESLAM_TEST_PROCESSORS says, here and in every process started from here.

``make test-fast PROCESSORS=8`` puts this folder on PYTHONPATH; Python imports a ``sitecustomize`` before all else.
What threads can run on is not changed: a machine of two runs eight threads on its two.
"""

import os

count = int(os.environ.get("MOTESLAM_TEST_PROCESSORS", "0"))
if count:
    os.cpu_count = lambda: count  # type: ignore[assignment]
    if hasattr(os, "process_cpu_count"):
        os.process_cpu_count = lambda: count  # type: ignore[assignment]
    if hasattr(os, "sched_getaffinity"):
        asked = os.sched_getaffinity
        # of this process as a whole; a thread's own mask is asked for by its number
        os.sched_getaffinity = lambda pid: set(range(count)) if pid == 0 else asked(pid)
