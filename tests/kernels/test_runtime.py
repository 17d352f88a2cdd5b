"""The seam to Taichi: quiet, offline, once a process, with a cache of its own; launches as fast as Taichi allows."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from moteslam.kernels.runtime import ti
from moteslam.kernels.types import F32, F32_1D, I32, I32_2D, U32, func, kernel, template

POSIX = pytest.mark.skipif(os.name != "posix", reason="file modes and signals of POSIX")
KERNEL = """
import numpy as np
from moteslam.kernels.matching import match_poses
grid = np.zeros((8, 8), np.uint8)
grid[3, 4] = 1
match = match_poses(
    grid, (0.0, 0.0), 1.0, [[0, 0, 0], [1, 0, 0]], [[4.5, 3.5], [3.5, 3.5], [3.6, 3.6]], offsets_xy=[0.0],
    offsets_theta=[0.0],
)
assert match.scores.tolist() == [1, 2], match
"""


def run(code: str, tmp_path: Path, **variables: str | None) -> str:
    """What the code prints in a process with a cache and a home folder of its own, that must print no error.

    A variable of the environment that is None is unset.
    """
    changed = {"HOME": str(tmp_path / "home"), "MOTESLAM_CACHE": str(tmp_path / "cache")} | variables
    environment = {name: value for name, value in (os.environ | changed).items() if value is not None}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def cache_of(tmp_path: Path) -> Path:
    """The folder the kernels are kept in."""
    (folder,) = (tmp_path / "cache").iterdir()
    return folder


OFFLINE = """
import os, sys

def no_network(event, arguments):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"):
        os.write(2, f"{event} {arguments}".encode())
        os._exit(70)

sys.addaudithook(no_network)
variables = dict(os.environ)
"""


def test_a_first_kernel_asks_no_network_prints_nothing_and_fills_the_cache_alone(tmp_path: Path) -> None:
    """And leaves the environment as it was."""
    (tmp_path / "home").mkdir()
    asked = {"TI_ARCH": "vulkan", "TI_SKIP_VERSION_CHECK": "OFF", "ENABLE_TAICHI_HEADER_PRINT": "1"}
    assert run(OFFLINE + KERNEL + "assert os.environ == variables", tmp_path, **asked) == ""
    kept = sorted(path.name for path in cache_of(tmp_path).glob("*.tic"))
    assert kept
    assert run(KERNEL, tmp_path) == ""  # and the same answer from the cache, nothing compiled again
    assert sorted(path.name for path in cache_of(tmp_path).glob("*.tic")) == kept
    assert not list((tmp_path / "home").iterdir())


@POSIX
def test_the_cache_folder_is_its_owners_alone_whatever_the_mask_and_whatever_it_was(tmp_path: Path) -> None:
    code = "import os; os.umask(0); from moteslam.kernels.runtime import init; print(init('cpu', 1).cache)"
    cache = Path(run(code, tmp_path).strip())
    assert cache == cache_of(tmp_path)
    assert cache.stat().st_mode & 0o777 == 0o700
    cache.chmod(0o777)
    run(code, tmp_path)
    assert cache.stat().st_mode & 0o777 == 0o700


def test_where_no_cache_can_be_had_kernels_run_without(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    code = KERNEL + "from moteslam.kernels.runtime import runtime; print(runtime().cache)"
    assert run(code, tmp_path, MOTESLAM_CACHE=str(tmp_path / "file" / "cache")) == "None\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.slow
def test_the_lock_of_a_killed_process_is_removed_and_kernels_are_kept_again(tmp_path: Path) -> None:
    run("from moteslam.kernels.runtime import init; init()", tmp_path)
    cache = cache_of(tmp_path)
    lock = cache / "ticache.lock"
    lock.touch()
    assert run(KERNEL, tmp_path) == ""  # locked out of the cache it computes all the same
    assert lock.exists()
    os.utime(lock, (time.time() - 120,) * 2)
    assert run(KERNEL, tmp_path) == ""
    assert not lock.exists()
    assert list(cache.glob("*.tic"))


@pytest.mark.parametrize("home", [None, "/proc/none"])
def test_kernels_run_wherever_home_is(home: str | None, tmp_path: Path) -> None:
    home = str(tmp_path / home) if home else home  # an absolute one stays as it is
    check = f"import os\nassert os.environ.get('HOME') == {home!r}, os.environ.get('HOME')\n"
    assert run(check + KERNEL + check, tmp_path, HOME=home, MOTESLAM_CACHE=None, XDG_CACHE_HOME=None) == ""


SETTINGS = """
import os
from moteslam.errors import BackendError
from moteslam.kernels.runtime import init, runtime
def refused(*args, **options):
    try:
        init(*args, **options)
    except BackendError as error:
        return error.field
    raise AssertionError(f"{args} {options} taken")
"""


def test_settings_are_checked_and_taken_once(tmp_path: Path) -> None:
    code = """
assert os.path.exists("/dev/nvidia0") or refused("cuda") == "arch"  # and the CPU serves still
print(refused("vulkan"), [refused("cpu", threads) for threads in (0, -3, 1025)])
first = init("cpu", 2)
assert init("cpu", 2) is init() is runtime() is first
print(refused("cpu", 3), refused("cuda"), refused("cpu", 2, debug=True))
"""
    assert run(SETTINGS + code, tmp_path) == "arch ['threads', 'threads', 'threads']\nNone None None\n"


MASKS = """
import os
from moteslam.kernels.runtime import init
allowed = sorted(os.sched_getaffinity(0))
before = os.listdir("/proc/self/task")
init("cpu", {threads})
masks = [os.sched_getaffinity(int(thread)) for thread in os.listdir("/proc/self/task") if thread not in before]
assert masks and os.sched_getaffinity(0) == set(allowed)
print(sorted({{tuple(sorted(mask)) for mask in masks[-{threads}:]}}) == {expected})
"""


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="Linux alone reports and sets where threads run")
@pytest.mark.parametrize(
    ("threads", "expected"),
    [("len(allowed)", "[(cpu,) for cpu in allowed]"), ("1 + len(allowed)", "[tuple(allowed)]")],
)
def test_as_many_threads_as_processors_have_one_each_and_others_are_free(
    threads: str, expected: str, tmp_path: Path
) -> None:
    if os.environ.get("MOTESLAM_TEST_PROCESSORS"):
        pytest.skip("threads cannot be placed on processors that are not there")
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one processor: nothing to choose from")
    assert run(MASKS.format(threads=threads, expected=expected) + KERNEL, tmp_path) == "True\n"


@kernel
def fill(values: F32_1D, add: F32, unsigned: U32, more: I32, factor: template, out: I32_2D):
    for i in range(values.shape[0]):
        out[i, 0] = ti.cast(values[i] + add, ti.i32) * ti.static(factor) + more
        out[i, 1] = ti.cast(unsigned // ti.u32(2), ti.i32)
        out[i, 2] = 3


@kernel
def keep(value: F32, out: F32_1D):
    for i in range(out.shape[0]):
        out[i] = value


@func
def inlined(x):
    return x + absent  # noqa: F821


@kernel
def unknown(values: F32_1D):
    values[0] = inlined(1.0)


@pytest.mark.usefixtures("taichi")
def test_numbers_and_arrays_arrive_and_each_template_has_its_own_form() -> None:
    out = np.zeros((2, 3), np.int32)
    for _ in range(3):  # the first call compiles, the others are launched directly
        for factor, add in ((2, 5), (3, np.int64(-7)), (2, True)):
            out[:] = 0
            fill(np.array([1.5, 2.5], np.float32), np.float32(0.5), 2**31 + 4, add, factor, out)
            expected = [(int(x + 0.5) * factor + int(add)) for x in (1.5, 2.5)]
            assert out.tolist() == [[value, 2**30 + 2, 3] for value in expected]


@pytest.mark.usefixtures("taichi")
def test_an_error_in_a_kernel_names_file_line_and_code() -> None:
    with pytest.raises(ti.TaichiNameError) as caught:
        unknown(np.zeros(2, np.float32))
    for part in (f'File "{__file__}", line ', "in unknown:", "values[0] = inlined(1.0)", "in inlined:", "x + absent"):
        assert part in str(caught.value)


@pytest.mark.usefixtures("taichi")
def test_arguments_that_change_between_launches_arrive() -> None:
    """Arguments that are equal to those of the last launch are not set again."""
    first, second = np.zeros((2, 3), np.int32), np.zeros((2, 3), np.int32)
    values = np.array([1.0, 2.0], np.float32)
    fill(values, 1.0, 1, 1, 2, first)
    for out, add, more in ((first, 1.0, 1), (second, 1.0, 1), (second, 2.0, 1), (first, 2.0, -1), (first, 0.0, 0)):
        values += 1  # in place: the same memory, other numbers
        fill(values, add, 1, more, 2, out)
        assert out[:, 0].tolist() == [int(v + add) * 2 + more for v in values]
    values.shape = (1, 2)  # the same array, of another shape
    with pytest.raises(Exception, match=r"."):
        fill(values, 1.0, 1, 1, 2, out)
    signs = np.zeros(1, np.float32)
    for zero in (0.0, -0.0, 0.0, np.nan, -0.0):
        keep(zero, signs)
        assert str(signs[0]) == str(np.float32(zero))


@pytest.mark.usefixtures("taichi")
def test_arguments_of_other_types_raise_taichis_errors_after_direct_launches_too() -> None:
    values, out = np.zeros(2, np.float32), np.zeros((2, 3), np.int32)
    right = (values, 1.0, 1, 1, 2, out)
    for _ in range(3):
        fill(*right)
    strided = np.zeros(4, np.float32)[::2]
    wrong = [(0, other) for other in (values.astype(np.float64), np.zeros((2, 2), np.float32), strided, None, "x")]
    for place, value in (*wrong, (1, "x"), (2, 1.5)):
        with pytest.raises(Exception, match=r"."):
            fill(*(value if k == place else each for k, each in enumerate(right)))
    with pytest.raises(Exception, match=r"."):
        fill(values, 1.0)


ANOTHER_RELEASE = """
import taichi as ti
ti.__version__ = (1, 7, 99)  # without the internals that are used of the one that is known
del ti.lang.ast.ast_transformer_utils.ASTTransformerContext, ti.lang._ndarray.ScalarNdarray
import numpy as np
from moteslam.kernels.motion import sample_motion
for _ in range(3):
    poses = np.zeros((3, 3))
    sample_motion(poses, (1, 0, 0.5), (0, 0, 0), seed=0, step=0)
    assert (poses == (1, 0, 0.5)).all(), poses
from moteslam.kernels import motion
assert motion._sample_motion._primal.compiled_kernels
print("launched by Taichi itself")
"""


def test_with_another_release_taichi_itself_loads_and_launches(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()  # which Taichi itself needs
    assert run(ANOTHER_RELEASE, tmp_path, ENABLE_TAICHI_HEADER_PRINT="0") == "launched by Taichi itself\n"
