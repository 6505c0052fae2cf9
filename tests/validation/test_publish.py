"""Defends: what is published says what the scorer found, failures as plainly as the rest, and can be read."""

import json
import struct

import pytest

from tests.validation.synthetic_bank import answer, confident, guessing, perfect, tying, write_bank
from validation.blind.__main__ import main
from validation.blind.score.report import as_json, score

ANSWERERS = (perfect, guessing, tying, confident)


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """Every answerer's figures as ``score --json`` writes them; cases are withheld from the perfect one."""
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
    """Cells of the table's rows by the text of the first."""
    lines = (folder / "table.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    assert {len(row) for row in rows} == {len(rows[0])}, "a row of another length is no table"
    return {row[0]: dict(zip(rows[0], row, strict=True)) for row in rows}


def test_every_figure_of_the_scorer_is_there_with_target_and_verdict(scored, published):
    table = cells(published)
    rows = json.loads(scored.read_text())["perfect"]["rows"]
    assert [row["text"] for row in rows] == list(table)[2:]
    for row in rows:
        assert table[row["text"]]["verdict"].strip("*") == row["verdict"]
        assert bool(table[row["text"]]["target"]) == bool(row["target"])


def test_who_knows_all_meets_all_that_was_judged_and_a_guesser_fails(scored, published, tmp_path):
    verdicts = {text: row["verdict"] for text, row in cells(published).items()}
    assert set(verdicts.values()) == {"verdict", "---", "", "**met**", "**not distinguishable**"}
    assert verdicts["right cause first, d* over 2"] == "**met**"
    assert main(["publish", "--score", str(scored), "--of", "guessing", "--out", str(tmp_path)]) == 0
    told = cells(tmp_path)
    assert told["right cause first, d* over 5"]["verdict"] == "**failed**"
    assert told["right cause first, d* over 5"]["perfect"].startswith("100 % [")


def test_shares_are_percent_with_their_bounds_and_other_figures_are_not(published):
    table = cells(published)
    first = table["right cause first, d* over 2"]
    assert (first["target"], first["cases"]) == ("at least 70 %", "72")
    assert first["perfect"] == "100 % [96, 100]"
    size = table["ids in the credible set, mean, d* over 2"]
    assert (size["target"], size["perfect"]) == ("at most 2", "1.00 [1.00, 1.00]")
    assert table["map of the explainable gap against truth, R2, d* over 2"]["perfect"] == "-"


def test_others_stand_beside_it_only_where_they_say_something(published):
    table = cells(published)
    assert table["a cause is named where there is none"]["tying"].startswith("100 %")
    assert table["calibration error of the likeliest, less chance"]["tying"] == "-"
    assert table["no wrong name with the cause withheld"]["guessing"] == "-"


def test_where_it_fails_is_told_beside_the_table(scored, tmp_path):
    assert main(["publish", "--score", str(scored), "--of", "confident", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "table.md").read_text()
    assert "\n168 cases. Bounds in brackets are one-sided" in text
    assert "Worst effects, right first: `" in text and "` 0 % [0, " in text
    assert "Named and right by d*: 1 to 2: " in text and "by EMG noise, d* over 2: 5 %: " in text


@pytest.mark.parametrize("name", ["right.png", "families.png"])
def test_pictures_are_large_enough_to_be_read(published, name):
    content = (published / name).read_bytes()
    width, height = struct.unpack(">II", content[16:24])
    assert width == 1800 and 900 < height < 1800 and len(content) > 30_000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file"),
        ("{", "not what this version"),
        ('{"it": {"rows": []}}', "not what this version"),
        ("{}", "no answerer at all"),
    ],
)
def test_what_the_scorer_has_not_written_is_refused(text, said, tmp_path, capsys):
    if text is not None:
        (tmp_path / "score.json").write_text(text)
    assert main(["publish", "--score", str(tmp_path / "score.json"), "--out", str(tmp_path / "out")]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_answerer_that_is_not_there_is_refused(scored, tmp_path, capsys):
    assert main(["publish", "--score", str(scored), "--of", "nobody", "--out", str(tmp_path)]) == 1
    assert "no answerer nobody; there are perfect, guessing" in capsys.readouterr().err
