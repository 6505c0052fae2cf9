"""Options in a settings file equal those on the command line, and stored settings can be repeated."""

import pytest

import wrapjax.cli.calibrate as command
from tests.cli.test_check import assert_only_errors
from wrapjax.cli.command_line import build_parser
from wrapjax.cli.common import DONE


@pytest.fixture
def received(monkeypatch):
    """Options that ``calibrate`` received; it only creates its folder."""
    seen = []

    def answer(options):
        seen.append(options)
        options.out.mkdir(parents=True)
        return DONE

    monkeypatch.setattr(command, "run", answer)
    return seen


def test_the_command_line_takes_precedence_over_the_file(run, received, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('method = "PGA"\nstarts = 7\nfit = "fits/one"\n')
    out = tmp_path / "run"
    assert run("calibrate", "anna", "--settings", file, "--starts", "2", "--out", out).status == DONE
    (options,) = received
    assert (options.method, options.starts, options.curves) == ("PGA", 2, "paper")
    assert options.tendon == "rigid"
    assert options.fit == tmp_path / "fits" / "one", "paths are relative to the file"


def test_stored_settings_repeat_a_command(run, received, tmp_path):
    first, second = tmp_path / "first", tmp_path / "elsewhere" / "second"
    words = ("--method", "LSGA", "--fit", tmp_path / "fit", "--seed", "3", "--max-iterations", "9")
    words += ("--tendon", "compliant")
    assert run("calibrate", "anna", *words, "--out", first).status == DONE
    assert run("calibrate", "anna", "--settings", first / "settings.toml", "--out", second).status == DONE
    one, other = (vars(options) | {"out": None, "settings": None} for options in received)
    other["fit"] = other["fit"].resolve()
    assert one == other
    kept = (second / "settings.toml").read_text()
    assert 'fit = "../../fit"' in kept and "force" not in kept and "out" not in kept.replace("without", "")
    assert 'tendon = "compliant"' in kept


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('methd = "PGA"', "did you mean 'method'"),
        ('method = "PGB"', "expected one of NGA, SGA, LSGA, PGA"),
        ("starts = 0", "above 0"),
        ("starts = [1]", "expected one value"),
        ("out = 'run'", "no such option"),
        ('command = "fit"', "is of 'wrapjax fit'"),
        ("starts = ", "is not valid TOML"),
        (None, "does not exist"),
        (b"\xff\xfe", "is not text"),
    ],
)
def test_errors_of_a_settings_file_are_reported(run, received, tmp_path, content, said):
    file = tmp_path / "settings.toml"
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    outcome = run("calibrate", "anna", "--settings", file, "--out", tmp_path / "run")
    assert_only_errors(outcome, tmp_path)
    assert said in outcome.progress and not received


def test_without_a_file_nothing_changes(run, received, tmp_path):
    outcome = run("calibrate", "anna", "--out", tmp_path / "run")
    assert outcome.status == 2 and "--method" in outcome.progress and not received


def test_no_two_arguments_of_a_command_share_a_value():
    """The file of ``--settings`` would otherwise replace what a command is about."""
    _, commands = build_parser()
    for name, parser in commands.items():
        places = [action.dest for action in parser._actions]
        assert len(places) == len(set(places)), name
