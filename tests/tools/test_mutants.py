"""The list of mutants: that each can be made, and that the table names them all. `make mutants` runs them."""

import pytest
from conftest import ROOT

from tools.mutants import NOT_RUN, TABLE, mutants, mutated, seen_by


@pytest.mark.parametrize("mutant", mutants(), ids=lambda each: each.what)
def test_each_mutant_changes_one_place(mutant):
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert mutated(mutant, text) != text
    assert seen_by(mutant)


def test_the_table_is_of_these_mutants():
    table = TABLE.read_text(encoding="utf-8")
    rows = [line.removeprefix("| ").split(" | ")[:2] for line in table.splitlines()[6:]]
    assert rows == [[each.what, f"`{each.file}`"] for each in mutants()]
    assert len(rows) >= 40
    not_run = sum(f"| {NOT_RUN} |" in line for line in table.splitlines())
    assert table.count("**no test**") <= 0.05 * (len(rows) - not_run)
    assert f"of {len(rows) - not_run} are seen" in table
