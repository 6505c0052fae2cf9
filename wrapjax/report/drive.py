"""What drove each muscle of a leg: an electrode, synergies of the measured EMG, or nothing."""

from __future__ import annotations

from wrapjax.calibrate import CalibrationResult
from wrapjax.report import markup
from wrapjax.report.figures import excitation_figure
from wrapjax.report.wording import counted
from wrapjax.subject import Subject

ELECTRODE, SYNERGIES, NOTHING = "electrode", "synergies", "not driven"


def describe_drive(subject: Subject) -> dict[str, dict[str, str | None]]:
    """Say by muscle what drove it, and the name of the channel or of the excitation.

    Returns
    -------
    dict
        Of every muscle of the leg's model: ``by`` is `ELECTRODE`, `SYNERGIES` or `NOTHING`, ``signal`` the
        name, None where nothing did.
    """
    drive: dict[str, dict[str, str | None]] = {
        muscle: {"by": ELECTRODE, "signal": channel} for muscle, channel in subject.channel_of.items()
    }
    if subject.synergies is not None:
        for name, members in subject.synergies.groups.items():
            drive |= {muscle: {"by": SYNERGIES, "signal": name} for muscle in members}
    return drive | {muscle: {"by": NOTHING, "signal": None} for muscle in subject.undriven_muscles}


def drive_section(subject: Subject, result: CalibrationResult) -> str:
    """Write the part of the report on what drove the muscles, with excitations that nobody measured."""
    members: dict[tuple[str, str], list[str]] = {}
    for muscle, own in describe_drive(subject).items():
        members.setdefault((str(own["by"]), own["signal"] or ""), []).append(muscle)
    table = markup.table(
        ("driven by", "channel or excitation", "muscles"),
        [(*key, ", ".join(muscles)) for key, muscles in members.items()],
        caption="Every muscle of this leg's model. A muscle that nothing drives has no force, passive force "
        "included.",
    )
    if subject.synergies is None:
        return markup.section("What drove the muscles", table)
    basis, muscles = subject.synergies.basis, subject.synergies.muscles
    share = 100.0 * float(basis.explained.sum())
    return markup.section(
        "What drove the muscles",
        table,
        markup.paragraph(
            f"{counted(len(muscles), 'muscle')} without an electrode got weighted sums of "
            f"{counted(basis.count - 1, 'principal component')} of the measured EMG, which hold "
            f"{share:.0f} % of its variance over the calibration cycles. Weights are one set for all cycles "
            "and were calibrated with everything else: no EMG vouches for these excitations, they are what "
            "explains the moments. An excitation that is wrong can hide what the model lacks elsewhere."
        ),
        markup.picture(
            excitation_figure(result, {name: _signal(subject, name) for name in muscles}),
            alternative=f"Excitation of {counted(len(muscles), 'muscle')} without an electrode over the "
            "gait cycle.",
            caption="Excitation (0 to 1, no unit) of the muscles without an electrode over the gait cycle, "
            "all cycles, delay and scale included: mean and one standard deviation to either side. Small "
            "print: the excitation, which muscles may have in common. All panels have one scale.",
        ),
    )


def _signal(subject: Subject, muscle: str) -> str:
    assert subject.synergies is not None
    return next(name for name, members in subject.synergies.groups.items() if muscle in members)
