"""The commands, one module each: `add` puts it on the parser, `run` does it."""

from wrapjax.commands import (
    calibrate,
    check,
    cohort,
    compare,
    contact,
    demo,
    diagnose,
    evaluate,
    fetch,
    fit,
    initialise,
    prepare,
    report,
)

#: Each adds its command to the parser; in the order that ``wrapjax --help`` shows them.
ADDED = (
    check.add,
    prepare.add,
    fit.add,
    initialise.add,
    calibrate.add,
    compare.add,
    diagnose.add,
    demo.add,
    fetch.add,
    evaluate.add,
    report.add,
    contact.add,
    cohort.add,
)
