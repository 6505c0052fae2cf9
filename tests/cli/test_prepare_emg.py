"""``wrapjax prepare`` on EMG: envelopes in place of raw EMG, and maximal contractions that normalise it."""

import numpy as np
import pytest

from tests.preprocessing import walker
from wrapjax.io.storage import read_storage, write_storage
from wrapjax.subject.emg_envelopes import compute_envelopes
from wrapjax.subject.subject import load_subject


@pytest.fixture
def solved(tmp_path):
    """Settings of the walker's files with angles, which may be modified."""
    return walker.write_laboratory_with_angles(tmp_path)


def with_contractions(settings, factors):
    """Give the settings recordings of contractions: the walker's EMG times a factor for each channel."""
    table = read_storage(settings.parent / "emg.sto")
    for number, factor in enumerate(factors):
        name = f"contraction_{number}.sto"
        write_storage(settings.parent / name, table)
        walker.change_table(
            settings,
            name,
            lambda time, columns, factor=factor: (
                time,
                {channel: factor.get(channel, 1.0) * volts for channel, volts in columns.items()},
            ),
        )
    names = ", ".join(f'"contraction_{number}.sto"' for number in range(len(factors)))
    walker.replace_text(settings, ('unit = "V"', f'unit = "V"\nmaximal_contractions = [{names}]'))


def test_maximal_contractions_normalise_raw_emg(run, solved):
    """Twice the EMG of walking in the contraction of a muscle halves its envelope in walking."""
    out = solved.parent / "out"
    assert run("prepare", solved, "--out", out).status == 0
    alone = load_subject(out).trials.emg
    with_contractions(solved, [{"Sol": 2.0}, {"TA": 4.0, "RF": 0.5}])
    outcome = run("prepare", solved, "--out", out, "--force")
    assert outcome.status == 0, outcome.progress
    assert 'maximal_contractions = ["maximal_contractions/01.sto", "maximal_contractions/02.sto"]' in (
        (out / "subject.toml").read_text()
    )
    subject = load_subject(out)
    emg, channels = subject.trials.emg, subject.trials.channels
    ratio = emg.max(axis=(0, 2)) / alone.max(axis=(0, 2))
    twice, four, once = (ratio[channels.index(name)] for name in ("Sol", "TA", "RF"))
    # Envelopes of contractions are filtered at 6 Hz, those of walking below.
    assert 0.8 < twice / (once / 2.0) < 1.25 and 0.8 < four / (once / 4.0) < 1.25
    np.testing.assert_allclose(emg / ratio[None, :, None], alone, rtol=1e-9, atol=1e-12)


def test_contractions_that_were_not_maximal_are_named(run, solved):
    with_contractions(solved, [{"Sol": 0.4}])
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 0, outcome.progress
    notes = load_subject(solved.parent / "out").notes
    (note,) = (one for one in notes if "maximal contraction" in one)
    assert "channel 'Sol' reaches" in note


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("contraction_0.sto", "contraction_9.sto", "expected a file, found no"),
        ('unit = "V"', 'kind = "envelope"', "expected none of envelopes"),
    ],
)
def test_faults_of_contractions_are_named(run, solved, old, new, words):
    with_contractions(solved, [{}])
    walker.replace_text(solved, (old, new))
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2 and words in outcome.progress and "maximal_contractions" in outcome.progress


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file: file.unlink(), "01.sto"),
        (lambda file: file.write_text(file.read_text().replace("Sol", "Other")), "column Sol"),
        (lambda file: file.write_text("nonsense"), "01.sto"),
    ],
)
def test_faults_in_a_subject_folder_are_named(run, solved, change, words):
    with_contractions(solved, [{}])
    out = solved.parent / "out"
    assert run("prepare", solved, "--out", out).status == 0
    change(out / "maximal_contractions" / "01.sto")
    outcome = run("check", out)
    assert outcome.status == 2 and words in outcome.progress


def test_envelopes_are_refused_as_raw_emg_and_the_hint_works(run, solved):
    table = read_storage(solved.parent / "emg.sto")
    envelopes = compute_envelopes(table.values.T, walker.EMG_RATE, walker.PERIOD)
    envelopes /= envelopes.max(axis=1, keepdims=True)
    walker.change_table(
        solved, "emg.sto", lambda time, columns: (time, dict(zip(columns, envelopes, strict=True)))
    )
    folder = solved.parent / "out"
    outcome = run("prepare", solved, "--out", folder)
    assert outcome.status == 2
    assert 'write kind = "envelope" in [emg], in place of unit and gain' in outcome.progress
    walker.replace_text(solved, ('unit = "V"', 'kind = "envelope"'))
    outcome = run("prepare", solved, "--out", folder)
    assert outcome.status == 0, outcome.progress
    assert "'Sol' is active" in outcome.output
    assert 'kind = "envelope"' in (folder / "subject.toml").read_text()
    kept = read_storage(folder / "trials" / "walk" / "emg.sto")
    expected = [np.interp(kept.time, table.time, row) for row in envelopes]
    np.testing.assert_allclose(kept.values.T, expected, atol=1e-6)
    assert load_subject(folder).trials.emg.max() == pytest.approx(1.0, abs=0.05)


ENVELOPES = {
    "dead": (lambda own: 0.0 * own, "is dead"),
    "raw": (lambda own: own - own.mean(), "is raw: expected an envelope"),
    "percent": (lambda own: 100.0 * np.abs(own), "expected an envelope normalised to about 1"),
}


@pytest.mark.parametrize("fault", ENVELOPES)
def test_channels_that_are_not_envelopes_are_named(run, solved, fault):
    spoil, said = ENVELOPES[fault]

    def change(time, columns):
        shape = {name: np.abs(np.sin((3.0 + row) * time)) for row, name in enumerate(columns)}
        return time, shape | {"RF": spoil(np.sin(7.0 * time))}

    walker.change_table(solved, "emg.sto", change)
    walker.replace_text(solved, ('unit = "V"', 'kind = "envelope"'))
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2 and said in outcome.progress and "channel RF" in outcome.progress


def test_envelopes_have_no_unit(run, solved):
    walker.replace_text(solved, ('unit = "V"', 'unit = "V"\nkind = "envelope"'))
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert outcome.status == 2 and "expected no unit and no gain of envelopes" in outcome.progress


def test_all_keys_of_emg_are_listed(run, solved):
    walker.replace_text(solved, ('unit = "V"', 'unit = "V"\nrate = 5'))
    outcome = run("prepare", solved, "--out", solved.parent / "out")
    assert (
        outcome.status == 2
        and "known: kind, unit, gain, maximal_contractions, accept, channels" in outcome.progress
    )
