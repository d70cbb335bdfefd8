"""Table 4 of 2014: from which numbers it was made.

The cells are {(i, j): item}. An item is what the ledger knows of the printed ratio of number i over number j:
`item.printed` is its text, `item.lost` says whether our copy has lost it, and `item.agrees(value)` whether a value
rounds to it.
"""

import numpy as np

MOST = 8  # vectors, symmetric and full matrices that a join is allowed


def numbers_behind(cells, known):
    """Return the whole numbers from which a table of ratios was made.

    known maps some of the indices to their numbers. For each other index the result lists the whole numbers up to
    10,000 that agree, at the printed digits, with every ratio to a known number.

    >>> from reproduction.ledger import Item
    >>> cells = {(0, 1): Item("t.1", "Table", "number", "2.00"), (1, 0): Item("t.2", "Table", "number", "0.500")}
    >>> numbers_behind(cells, known={0: 10})
    {1: [5]}
    """
    printed = [pair for pair, item in cells.items() if not item.lost]
    behind = {}
    for unknown in sorted({i for pair in cells for i in pair} - set(known)):
        pairs = [pair for pair in printed if set(pair) - set(known) == {unknown}]
        behind[unknown] = []
        for number in range(1, 10_001):
            numbers = {**known, unknown: number}
            if all(cells[i, j].agrees(numbers[i] / numbers[j]) for i, j in pairs):
                behind[unknown].append(number)
    return behind


def cells_of(paper):
    """Return the items of Table 4 as {(row, column): item}, counted from 0.

    >>> from reproduction import published
    >>> cells_of(published("2014_gsm_2d"))[0, 1].printed
    '0.760'
    """
    places = {id: id.removeprefix("table4.").split(".") for id in paper.layouts["table4"].ids}
    return {(int(row) - 1, int(column) - 1): paper.items[id] for id, (row, column) in places.items()}


def joins_tried(behind, counts):
    """Return, for both joins, which sums of vectors and matrices fit the counts behind Table 4 in both models.

    behind maps a join's index to its count in the table, counts are those of all twelve. A row is: the join, what its
    count leaves over the two filters in model A, how often the filters are taken in model B, what is left there, and
    the joins that fit both.
    """
    rows = []
    for name, join in (("JKLF", 2), ("JSSKLF", 5)):
        filters_a, filters_b = (sum(counts[join - 2 + model : join + model]) for model in (0, 6))
        over_a = behind[join] - filters_a
        for taken in (1, 2):
            over_b = behind[join + 6] - taken * filters_b
            fitting = []
            for times, a, b, c in np.ndindex(5, MOST + 1, MOST + 1, MOST + 1):
                cost = {n: a * n + b * n * (n + 1) // 2 + c * n**2 for n in (4, 2)}
                if times and (cost[4], times * cost[2]) == (over_a, over_b):
                    fitting.append(f"{times} times {a} vectors, {b} symmetric, {c} full")
            rows.append([name, over_a, taken, over_b, "; ".join(fitting) or "none"])
    return rows
