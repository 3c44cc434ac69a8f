"""The thread pool of the CPU build by itself, in C++: exceptions, nesting, forks, float mode, streaming stores.

What exceptions and locks do is also watched by the address and the thread sanitizer, where the compiler has them. The scenarios
that fork are not: the sanitizers' own locks do not survive a fork amid threads.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
CPU = HERE.parents[1] / "bigtri/csrc/cpu"
COMPILER = os.environ.get("CXX") or "c++"
FLAGS = ("-std=c++17", "-O1", "-g", "-pthread", "-Wall", "-Wextra", "-Werror")

THROWING = ("throw_on_caller", "throw_on_worker", "all_throw", "throw_on_one_thread")
ANYWHERE = ("each_index_once", *THROWING, "nested", "nested_in_the_last_body", "several_callers", "load")
X86 = ("float_mode", "streaming_stores")
FORKS = ("fork_handler_allocates_nothing", "fork_amid_first_job", "fork_while_others_work")
SCENARIOS = {"none": (*ANYWHERE, *X86, *FORKS), "address": ANYWHERE, "thread": ANYWHERE}

pytestmark = [
    pytest.mark.skipif(not shutil.which(COMPILER), reason="no C++ compiler"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here"),
]


def compile_with(sanitizer: str, sources: list[Path], out: Path) -> subprocess.CompletedProcess[str]:
    flags = [*FLAGS, f"-I{CPU}"] if sanitizer == "none" else [*FLAGS, f"-I{CPU}", f"-fsanitize={sanitizer}"]
    return subprocess.run([COMPILER, *flags, *map(str, sources), "-o", str(out)], capture_output=True, text=True)


def play(program: Path, *scenario: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(program), *scenario], capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path | None]:
    """The program for each sanitizer, None where the compiler or the system does not have it."""
    folder = tmp_path_factory.mktemp("thread_pool")
    empty = folder / "empty.cpp"
    empty.write_text("int main() {}\n")
    built: dict[str, Path | None] = {}
    for sanitizer in SCENARIOS:
        trial, program = folder / f"empty_{sanitizer}", folder / sanitizer
        if sanitizer != "none" and (compile_with(sanitizer, [empty], trial).returncode or play(trial).returncode):
            built[sanitizer] = None
            continue
        compiled = compile_with(sanitizer, [CPU / "thread_pool.cpp", HERE / "thread_pool_test.cpp"], program)
        assert compiled.returncode == 0, compiled.stderr
        built[sanitizer] = program
    return built


@pytest.mark.parametrize(("sanitizer", "scenario"), [(s, one) for s, some in SCENARIOS.items() for one in some])
def test_scenario(programs: dict[str, Path | None], sanitizer: str, scenario: str) -> None:
    program = programs[sanitizer]
    if program is None:
        pytest.skip(f"no {sanitizer} sanitizer here")
    if scenario in X86 and platform.machine() not in ("x86_64", "AMD64"):
        pytest.skip("x86-64 only")
    played = play(program, scenario)
    assert played.returncode == 0, f"ended with {played.returncode}: {played.stderr}"


def test_every_scenario_is_played(programs: dict[str, Path | None]) -> None:
    assert programs["none"] is not None
    there = play(programs["none"]).stdout.split()
    assert set(there) == {s for s in SCENARIOS["none"] if s in there or s not in X86}
