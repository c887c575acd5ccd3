"""How an extra is installed, by where decogs itself came from."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from decogs.formats.system import extras


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """As if decogs had been installed with this direct_url.json of PEP 610; None: not at all."""

    def install(origin: dict[str, Any] | str | None) -> str:
        class Distribution:
            def read_text(self, name: str) -> str | None:
                assert name == "direct_url.json"
                return json.dumps(origin) if isinstance(origin, dict) else None

        def distribution(name: str) -> Distribution:
            if origin is None:
                raise metadata.PackageNotFoundError(name)
            return Distribution()

        monkeypatch.setattr(metadata, "distribution", distribution)
        return extras.install("encode")

    return install


def test_an_extra_comes_from_where_decogs_came_from(installed: Any, tmp_path: Path) -> None:
    checkout = tmp_path / "a check-out of é"
    checkout.mkdir()
    folder = {"url": checkout.as_uri(), "dir_info": {}}
    assert installed(folder) == f"pip install '{checkout}[encode]'"
    assert installed(folder | {"dir_info": {"editable": True}}) == f"pip install -e '{checkout}[encode]'"
    wheel = tmp_path / "decogs-0.1.0-cp310-abi3-linux_x86_64.whl"
    wheel.touch()
    assert installed({"url": wheel.as_uri(), "archive_info": {}}) == f"pip install '{wheel}[encode]'"
    wheel.unlink()
    by_name = "pip install 'decogs[encode]'"
    assert installed({"url": wheel.as_uri(), "archive_info": {}}) == by_name, "it is not there any more"
    assert installed({"url": "https://example.org/decogs.git", "vcs_info": {"vcs": "git"}}) == by_name
    assert installed("from an index") == by_name
    assert installed(None) == by_name


@pytest.mark.parametrize(
    ("module", "whole", "library", "extra"),
    [
        ("cv2", None, "OpenCV", "encode"),
        ("av.video", None, "PyAV", "video"),
        ("av", "encode", "PyAV", "encode"),
        ("pxr", "encode", "OpenUSD", "usd"),
    ],
)
def test_what_lacks_brings_the_least_or_all_of_a_command(module: str, whole: Any, library: str, extra: str) -> None:
    words = extras.what_to_install(ModuleNotFoundError(name=module), whole=whole)
    assert words == f"this needs {library}, which is not installed: {extras.install(extra)}"


def test_what_no_extra_brings_is_an_error_of_its_own() -> None:
    assert extras.what_to_install(ModuleNotFoundError(name="avocado")) is None
    assert extras.what_to_install(ModuleNotFoundError()) is None
