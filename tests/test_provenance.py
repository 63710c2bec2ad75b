"""What is written beside measured numbers."""

import subprocess

import pytest

import oitlab
from oitlab import _provenance


def test_it_names_machine_versions_and_date() -> None:
    about = _provenance.provenance()
    assert about["versions"]["oitlab"] == oitlab.__version__
    assert about["date"].endswith(" UTC")
    assert about["cores"] >= 1
    assert about["cpu"]


def test_changed_code_is_told_and_changed_results_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """The commit is `git`'s; "-dirty" comes from the status of the code's folders alone."""
    asked: list[tuple[str, ...]] = []
    answers = {"rev-parse": "0123456789", "status": ""}

    def git(*arguments: str) -> str:
        asked.append(arguments)
        return answers[arguments[0]]

    monkeypatch.setattr(_provenance, "_git", git)
    assert _provenance.provenance()["commit"] == "0123456789"
    answers["status"] = " M src/render.rs"
    assert _provenance.provenance()["commit"] == "0123456789-dirty"
    status = next(arguments for arguments in asked if arguments[0] == "status")
    assert {":/src", ":/python"} <= set(status)
    assert ":/docs" not in status


def test_without_git_there_is_no_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*_: str) -> str:
        raise subprocess.CalledProcessError(128, "git")

    monkeypatch.setattr(_provenance, "_git", git)
    assert _provenance.provenance()["commit"] is None
