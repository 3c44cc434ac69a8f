"""Every test module can import by its bare name what lies here (cases, counting, backends) or in the other folders.

``--all`` runs the whole product of cases too, exhaustive.py; without it, what is marked so is not even collected.
"""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(folder) for folder in sorted(HERE.iterdir()) if folder.is_dir())]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="the whole product of cases too, which takes some four times as long")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--all"):
        return
    left_out = [item for item in items if item.get_closest_marker("exhaustive")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if not item.get_closest_marker("exhaustive")]


@pytest.fixture
def no_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it were not installed, whoever has imported it before."""
    import bigtri.study

    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name in ("accuracy_plots", "pyplot", "work_plots"):
        monkeypatch.delitem(sys.modules, f"bigtri.study.{name}", raising=False)
        monkeypatch.delattr(bigtri.study, name, raising=False)
