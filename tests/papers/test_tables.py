"""Tables of the notebooks: their text, their HTML and their Markdown."""

import numpy as np
import pytest

from reproduction.ledger.tables import Table, cell_text, gap_text


def test_a_table_prints_and_displays_the_same_cells():
    table = Table(["a<b", "n"], [["x & y", 1 / 3], ["z", 12]])
    assert repr(table) == "a<b    n\nx & y  0.333333\nz      12"
    html = table._repr_html_()
    assert "<th>a&lt;b</th>" in html
    assert "<td>x &amp; y</td><td>0.333333</td>" in html


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (123456.789, "123457"), (1e-7, "1e-07"), (3, "3"), ("π", "π"), (False, "no"),
        (np.True_, "yes"), (np.float32(1 / 3), "0.333333"), (np.int64(5), "5"), (-0.0, "0"), (-1.5, "-1.5"),
    ],
)  # fmt: skip
def test_cells_hold_at_most_six_digits(value, text):
    assert cell_text(value) == text


@pytest.mark.parametrize(
    ("gap", "text"),
    [
        (0, "below 1e-12"),
        (9.9e-13, "below 1e-12"),
        (1e-12, "1.0e-12"),
        (0.5, "5.0e-01"),
        (-5.0, "-5.0e+00"),
        (-1e-13, "below 1e-12"),
    ],
)
def test_gaps_at_rounding_level_have_no_digits(gap, text):
    assert gap_text(gap) == text


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match=r"rows\[1\]: needs 2 cells, got 1"):
        Table(["a", "b"], [[1, 2], [3]])
