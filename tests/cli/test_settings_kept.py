"""All commands that write a result folder store their options in it, and read them from such a file."""

import argparse

import pytest

import wrapjax.cli.evaluate
import wrapjax.cli.initialise
from wrapjax.cli.command_line import build_parser
from wrapjax.cli.common import DONE

#: Those that write a subject's folder, an index or a page: their settings are not those of a command.
WITHOUT = {"prepare", "fetch", "report", "check", "show"}


def test_all_commands_that_write_take_settings():
    _, commands = build_parser()
    writing = {
        name
        for name, parser in commands.items()
        if any("--out" in action.option_strings for action in parser._actions)
    }
    taking = {name for name, parser in commands.items() if "--settings" in parser._option_string_actions}
    assert taking == writing - WITHOUT


@pytest.fixture
def received(monkeypatch):
    """Options that the commands received; they only create their folders."""
    seen: list[argparse.Namespace] = []

    def answer(options):
        seen.append(options)
        if options.out:
            options.out.mkdir()
        return DONE

    for module in (wrapjax.cli.evaluate, wrapjax.cli.initialise):
        monkeypatch.setattr(module, "run", answer)
    return seen


def test_initialise_stores_and_reads_its_options(run, received, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    assert run("initialise", "anna", "--curves", "opensim", "--out", first).status == DONE
    assert 'curves = "opensim"' in (first / "settings.toml").read_text()
    assert run("initialise", "bert", "--settings", first / "settings.toml", "--out", second).status == DONE
    assert [options.curves for options in received] == ["opensim", "opensim"]


def test_evaluate_stores_settings_in_its_folder(run, received, tmp_path):
    out = tmp_path / "out"
    assert run("evaluate", "run", "anna", "--out", out).status == DONE
    assert 'command = "evaluate"' in (out / "settings.toml").read_text()
    assert run("evaluate", "run", "anna", "--settings", out / "settings.toml").status == DONE
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["out", "settings.toml"]
    outcome = run("initialise", "anna", "--settings", out / "settings.toml", "--out", tmp_path / "other")
    assert outcome.status == 2 and "is of 'wrapjax evaluate'" in outcome.progress
