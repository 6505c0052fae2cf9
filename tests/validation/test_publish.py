"""Published table and figures of a score."""

import json
import struct

import pytest

from tests.validation.synthetic_bank import answer, confident, guessing, perfect, tying, write_bank
from validation.blind.__main__ import main
from validation.blind.score.report import as_json, score

ANSWERERS = (perfect, guessing, tying, confident)


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """Write the scores of all answerers like ``score --json``, with withheld causes for one."""
    folder = tmp_path_factory.mktemp("bank")
    truths = write_bank(folder / "bank", single=96, other=24, people=32)
    for truth in truths:
        for answerer in ANSWERERS:
            answer(folder / answerer.__name__, truth, answerer(truth))
        if truth["tier"] == "single":
            answer(folder / "withheld", truth, perfect(truth, withheld=True))
    answers = {one.__name__: folder / one.__name__ for one in ANSWERERS}
    file = folder / "score.json"
    file.write_text(as_json(score(folder / "bank", answers, {"perfect": folder / "withheld"})))
    return file


@pytest.fixture(scope="module")
def published(scored, tmp_path_factory):
    folder = tmp_path_factory.mktemp("published")
    assert main(["publish", "--score", str(scored), "--out", str(folder)]) == 0
    return folder


def cells(folder):
    """Read the rows of the table by the text of their first cell."""
    lines = (folder / "table.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    assert {len(row) for row in rows} == {len(rows[0])}, "rows differ in length"
    return {row[0]: dict(zip(rows[0], row, strict=True)) for row in rows}


def test_table_has_all_figures_with_target_and_verdict(scored, published):
    table = cells(published)
    rows = json.loads(scored.read_text())["perfect"]["rows"]
    assert [row["text"] for row in rows] == list(table)[2:]
    for row in rows:
        assert table[row["text"]]["verdict"].strip("*") == row["verdict"]
        assert bool(table[row["text"]]["target"]) == bool(row["target"])


def test_perfect_answerer_meets_targets_and_guessing_fails(scored, published, tmp_path):
    verdicts = {text: row["verdict"] for text, row in cells(published).items()}
    assert set(verdicts.values()) == {"verdict", "---", "", "**met**", "**not distinguishable**"}
    assert verdicts["right cause first, d* over 2"] == "**met**"
    assert main(["publish", "--score", str(scored), "--of", "guessing", "--out", str(tmp_path)]) == 0
    guessed = cells(tmp_path)
    assert guessed["right cause first, d* over 5"]["verdict"] == "**failed**"
    assert guessed["right cause first, d* over 5"]["perfect"].startswith("100 % [")


def test_shares_are_in_percent_with_bounds(published):
    table = cells(published)
    first = table["right cause first, d* over 2"]
    assert (first["target"], first["cases"]) == ("at least 70 %", "72")
    assert first["perfect"] == "100 % [96, 100]"
    size = table["ids in the credible set, mean, d* over 2"]
    assert (size["target"], size["perfect"]) == ("at most 2", "1.00 [1.00, 1.00]")
    assert table["map of the explainable gap against truth, R2, d* over 2"]["perfect"] == "-"


def test_other_answerers_are_listed_where_comparable(published):
    table = cells(published)
    assert table["a cause is named where there is none"]["tying"].startswith("100 %")
    assert table["calibration error of the likeliest, less chance"]["tying"] == "-"
    assert table["no wrong name with the cause withheld"]["guessing"] == "-"


def test_worst_effects_are_listed(scored, tmp_path):
    assert main(["publish", "--score", str(scored), "--of", "confident", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "table.md").read_text()
    assert "\n168 cases. Bounds in brackets are one-sided" in text
    assert "Worst effects, right first: `" in text and "` 0 % [0, " in text
    assert "Named and right by d*: 1 to 2: " in text and "by EMG noise, d* over 2: 5 %: " in text


@pytest.mark.parametrize("name", ["right.png", "families.png"])
def test_figures_have_the_expected_size(published, name):
    content = (published / name).read_bytes()
    width, height = struct.unpack(">II", content[16:24])
    assert width == 1800 and 900 < height < 1800 and len(content) > 30_000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "No such file"),
        ("{", "not what this version"),
        ('{"it": {"rows": []}}', "not what this version"),
        ("{}", "no answerer at all"),
    ],
)
def test_other_files_are_rejected(text, message, tmp_path, capsys):
    if text is not None:
        (tmp_path / "score.json").write_text(text)
    assert main(["publish", "--score", str(tmp_path / "score.json"), "--out", str(tmp_path / "out")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_unknown_answerer_is_rejected(scored, tmp_path, capsys):
    assert main(["publish", "--score", str(scored), "--of", "nobody", "--out", str(tmp_path)]) == 1
    assert "no answerer nobody; there are perfect, guessing" in capsys.readouterr().err
