"""Commands that have a module each. `wrapjax.cli` has the others, and calls these."""

from wrapjax.commands import cohort, contact, evaluate, fetch, report

#: Each adds its command to the parser.
ADDED = (fetch.add, evaluate.add, report.add, contact.add, cohort.add)
