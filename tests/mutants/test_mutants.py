"""Every mutation has its place in the sources: mutants.py itself takes too long for every day."""

from __future__ import annotations

import mutants
import pytest

MUTATIONS = [(file, mutation) for file in ("mutants.txt", "mutants_cuda.txt") for mutation in mutants.read_mutations(file)]


@pytest.mark.parametrize(("file", "mutation"), MUTATIONS, ids=[f"{file}-{mutation.name}" for file, mutation in MUTATIONS])
def test_has_its_place(file: str, mutation: mutants.Mutation) -> None:
    mutants.place_of(mutants.ROOT, mutation)


def test_no_name_twice() -> None:
    names = [(file, mutation.name) for file, mutation in MUTATIONS]
    assert len(set(names)) == len(names) > 150
