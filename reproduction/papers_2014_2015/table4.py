"""Table 4 of 2014: from which numbers it was made.

The cells are {(i, j): item}. An item is what the ledger knows of the printed ratio of number i over number j:
`item.printed` is its text, `item.lost` says whether our copy has lost it, and `item.agrees(value)` whether a value
rounds to it.
"""


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
