"""Breaks the extension on purpose, one formula at a time, and checks that the tests fail and name the stage.

The mutations are in mutants.txt, with --cuda in mutants_cuda.txt: those of the CUDA kernels, which need a GPU, or with --on-cpu
only the headers of the CUDA toolkit (test_cuda*_on_cpu.py; those in core/ are left out then). The repository is copied to a
temporary directory, with one instruction set and less optimisation, so that building is quick. A mutation is KILLED if a test
fails and names one of the stages expected; one with a reason why nothing can tell is EQUIVALENT and has to survive. The exit
status is 1 if any verdict is another, or if a mutation has lost its place.
"""

from __future__ import annotations

import argparse
import glob
import importlib
import multiprocessing
import os
import re
import runpy
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 400  # s, for one build and for one test run
FORK = multiprocessing.get_context("fork")  # children share what is slow to import
HEADER = re.compile(r"(\w+) (\S+): ([\w ]+?)((?: \w+=\w+)*)")


class Mutation(NamedTuple):
    name: str
    where: str  # file or directory in bigtri/csrc
    stages: list[str]  # one of these is named
    old: str  # there exactly once, whatever its white space
    new: str
    test: str = "native"  # tests/*/test_<test>.py
    isa: str = "avx2"
    equivalent: str = ""  # why nothing can tell


def read_mutations(file: str) -> list[Mutation]:
    """Blocks of the file: ``name where: stages option=value``, ``- old``, ``+ new`` and, if no test can tell, ``= why``."""
    mutations = []
    for block in re.sub(r"^#.*\n", "", ROOT.joinpath("tests/mutants", file).read_text(), flags=re.M).strip().split("\n\n"):
        header, *lines = block.strip().split("\n")
        found = HEADER.fullmatch(header)
        if not found:
            raise ValueError(f"{file}: not a header: {header}")
        text = {sign: "\n".join(line[2:] for line in lines if line[0] == sign) for sign in "-+="}
        options = dict(option.split("=") for option in found[4].split())
        mutations.append(Mutation(found[1], found[2], found[3].split(), text["-"], text["+"], equivalent=text["="], **options))
    return mutations


def place_of(root: Path, mutation: Mutation) -> tuple[Path, re.Match[str]]:
    """The one place of a mutation's old text.

    Raises:
        LookupError: there is none, or there are several.
    """
    pattern = re.compile(r"\s+".join(re.escape(word) for word in mutation.old.split()))
    where = root / "bigtri/csrc" / mutation.where
    files = [where] if where.is_file() else sorted(f for f in where.rglob("*") if f.is_file())
    found = [(file, match) for file in files for match in pattern.finditer(file.read_text())]
    if len(found) != 1:
        raise LookupError(f"{mutation.name}: its old text is in {mutation.where} {len(found)} times, not once")
    return found[0]


def has_isa(isa: str) -> bool:
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    return isa == "baseline" or {"avx2": "avx2", "avx512": "avx512dq"}[isa] in flags


def in_child(folder: Path, body: Callable[[], Any]) -> tuple[int, str]:
    """Run ``body`` in a forked process in ``folder``: its exit status (negative: a signal) and all that it printed.

    Raises:
        TimeoutError: it ran past the limit.
    """

    def child() -> None:
        os.chdir(folder)
        os.dup2(out.fileno(), 1)
        os.dup2(out.fileno(), 2)
        sys.path[:0] = [str(folder), str(folder / "tests")]
        sys.exit(body())

    with tempfile.TemporaryFile("w+") as out:
        process = FORK.Process(target=child)
        process.start()
        process.join(LIMIT)
        if process.is_alive():
            process.kill()
            process.join()
            raise TimeoutError(f"after {LIMIT} s")
        out.seek(0)
        return process.exitcode or 0, out.read()


class Copy:
    """A copy of the repository, built with one instruction set under the name of the one that every machine has.

    cuda: build for CUDA too; what is mutated in core/ is then what nvcc reads, and the CPU stays as it is.
    """

    def __init__(self, root: Path, cuda: bool) -> None:
        self.root, self.isa, self.cuda = root, "", cuda
        for name in ("bigtri", "tests"):
            shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
        for name in ("setup.py", "pyproject.toml"):
            shutil.copy(ROOT / name, root / name)
        cpu = root / "bigtri/csrc/cpu"
        self.kernels = {isa: (cpu / f"isa_{isa}.cpp").read_text() for isa in ("baseline", "avx2", "avx512")}
        for isa in ("avx2", "avx512"):
            (cpu / f"isa_{isa}.cpp").unlink()
        changes = (
            ("bigtri/csrc/cpu/dispatch.cpp", r"defined\(__x86_64__\)", "0"),
            ("bigtri/csrc/cpu/kernels.cpp", r"defined\(__x86_64__\)", "0"),
            # Mutations are of what the rungs share, so the default alone, which is the first, is enough.
            ("bigtri/csrc/core/precision.h", r"(#define BIGTRI_RUNGS\(X\) X\(\w+\)).*", r"\1"),
            ("bigtri/csrc/core/precision.h", r"(#define BIGTRI_LADDER\(X\)).*\\\n(.*\\\n)*.*", r"\1"),
            ("bigtri/csrc/cpu/variants.h", r"#define BIGTRI_CPU_VARIANTS_(?!exact\b)\w+\(X\)(.*\\\n)*.*\n", ""),
            ("bigtri/csrc/cuda/variants.h", r"#define BIGTRI_CUDA_VARIANTS_(?!exact\b)\w+\(X\).*\n", ""),
            (
                "bigtri/precision.py",
                r"PRECISIONS = .*",
                "PRECISIONS = tuple(RUNGS)[:1]\nRUNGS = {PRECISIONS[0]: RUNGS[PRECISIONS[0]]}",
            ),
            ("setup.py", '"-O3"', '"-O1"'),
        )
        for file, old, new in changes:
            text = (root / file).read_text()
            text, count = re.subn(old, new, text)
            assert count, (file, old)
            (root / file).write_text(text)

    def build(self, isa: str) -> None:
        if isa != self.isa:
            text = self.kernels[isa].replace(f"TABLE({isa})", "TABLE(baseline)")
            (self.root / "bigtri/csrc/cpu/isa_baseline.cpp").write_text(text)
            self.isa = isa

        def body() -> None:
            os.environ["BIGTRI_CUDA"] = str(int(self.cuda))
            sys.argv = ["setup.py", "-q", "build_ext", "--inplace"]
            runpy.run_path("setup.py", run_name="__main__")

        status, said = in_child(self.root, body)
        if status:
            raise RuntimeError("does not build:\n" + said[-3000:])

    def test(self, name: str) -> tuple[int, str]:
        """pytest's exit status, and what it says of a stage, or the name of the test that failed."""
        options = ["-x", "-q", "--tb=short", "-p", "no:cacheprovider", "-W", "ignore"]
        status, said = in_child(
            self.root, lambda: importlib.import_module("pytest").main([*glob.glob(f"tests/*/test_{name}.py"), *options])
        )
        found = re.search(r"stage \w+, .*", said) or re.search(r"^FAILED tests/\w+/test_(.*)", said, re.M)
        return status, found[0] if found else said[-300:]

    def judge(self, mutation: Mutation) -> tuple[str, str]:
        """The verdict, and what the tests said."""
        file, match = place_of(self.root, mutation)
        before, new = file.read_text(), mutation.new
        if self.cuda and file.parent.name == "core":
            new = f"\n#ifdef __CUDACC__\n{new}\n#else\n{match[0]}\n#endif\n"
        file.write_text(before[: match.start()] + new + before[match.end() :])
        try:
            self.build(mutation.isa)
            status, said = self.test(mutation.test)
        except TimeoutError as error:
            return "TIMEOUT", str(error)
        except RuntimeError as error:
            return "BROKEN", str(error)
        finally:
            file.write_text(before)
        if status == 0:
            return ("EQUIVALENT", mutation.equivalent) if mutation.equivalent else ("SURVIVED", "")
        if status != 1:
            return "CRASHED", said
        if mutation.equivalent:
            return "DIFFERENT", said
        stage = re.search(r"stage (\w+)|tests/\w+/test_(\w+)", said)
        return "KILLED" if stage and (stage[1] or stage[2]) in mutation.stages else "MISNAMED", said


_copy: Copy | None = None  # of this process


def start_worker(folder: str, cuda: bool) -> None:
    global _copy
    for slow in ("numpy", "torch.utils.cpp_extension", "trimesh", "pytest", "setuptools"):
        importlib.import_module(slow)
    _copy = Copy(Path(tempfile.mkdtemp(dir=folder)), cuda)


def check_unmutated(tests: list[str]) -> str:
    """What fails before anything is broken."""
    assert _copy
    _copy.build("avx2" if has_isa("avx2") else "baseline")
    if _copy.cuda and in_child(_copy.root, lambda: "cuda" not in importlib.import_module("bigtri.native").devices())[0]:
        return "there is no CUDA device, and without one they are skipped"
    return "\n".join(said for status, said in map(_copy.test, tests) if status)


def work(mutation: Mutation) -> bool:
    assert _copy
    start = time.perf_counter()
    verdict, said = _copy.judge(mutation) if has_isa(mutation.isa) else ("SKIPPED", "not on this machine")
    print(f"{mutation.name:20} {verdict:10} {time.perf_counter() - start:3.0f} s  {said}", flush=True)
    return verdict in ("KILLED", "EQUIVALENT", "SKIPPED")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuda", action="store_true", help="mutations of the CUDA kernels, on a machine with a GPU")
    parser.add_argument("--on-cpu", action="store_true", help="with --cuda: without a GPU")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="run these mutations")
    parser.add_argument("--list", action="store_true", help="print the mutations and whether each has its place, and stop")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="mutations worked on at the same time (1)")
    arguments = parser.parse_args()
    mutations = read_mutations("mutants_cuda.txt" if arguments.cuda else "mutants.txt")
    if unknown := set(arguments.only or []) - {m.name for m in mutations}:
        parser.error(f"no such mutation: {', '.join(sorted(unknown))}")
    chosen = [m for m in mutations if not arguments.only or m.name in arguments.only]
    if arguments.on_cpu:
        names = [m.test.removesuffix("_on_cpu") + "_on_cpu" for m in chosen]
        chosen = [m._replace(test=n, stages=[n]) for m, n in zip(chosen, names, strict=True) if not m.where.startswith("core")]
    on_gpu = arguments.cuda and not arguments.on_cpu
    if on_gpu:  # some only the order of threads that a CPU can choose brings to light
        chosen = [m for m in chosen if not m.test.endswith("on_cpu")]
    placed = []
    for m in chosen:
        try:
            file, match = place_of(ROOT, m)
        except LookupError as error:
            print(error)
            continue
        placed.append(m)
        if arguments.list:
            line = file.read_text()[: match.start()].count("\n") + 1
            print(f"{m.name:20} {'/'.join(m.stages):28} {file.relative_to(ROOT)}:{line}")
    complete = len(placed) == len(chosen)
    if not complete:
        print(f"{len(chosen) - len(placed)} of {len(chosen)} have lost their place")
    if arguments.list:
        return int(not complete)
    if on_gpu and in_child(ROOT, lambda: not importlib.import_module("torch").cuda.is_available())[0]:
        print("--cuda needs a torch built for CUDA and a GPU")
        return 1
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(arguments.jobs, FORK, start_worker, (folder, on_gpu)) as pool,
    ):
        if failure := pool.submit(check_unmutated, sorted({m.test for m in placed})).result():
            print(f"The tests fail without any mutation: {failure}")
            return 1
        good = sum(pool.map(work, placed))
    print(f"{good} of {len(chosen)} as expected")
    return int(not complete or good < len(chosen))


if __name__ == "__main__":
    sys.exit(main())
