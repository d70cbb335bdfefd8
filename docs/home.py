"""The numbers of the home page, computed by the package or from the verdicts; its words stand in papers.toml."""

from typing import NamedTuple

import break_sensor

from reproduction import burden
from reproduction.ledger.verdicts import CANNOT_BE_CHECKED, DIFFERS, ERRATUM, HOLDS, IN_PART

AXES = 2  # operations are those of a track in the plane
# How items come out, in words, with the verdict that gives the colour.
WORDS = {
    "hold": HOLDS,
    "hold in part": (IN_PART,),
    "fail": (DIFFERS, ERRATUM),
    "cannot be checked": (CANNOT_BE_CHECKED,),
}


class Outcome(NamedTuple):
    """How many items of a paper come out alike: the verdict that colours them, the words, and the number."""

    verdict: str
    words: str
    count: int


def answer():
    """Return the numbers of the answer above the figure: operations in the plane, and when each filter is right."""
    gap = break_sensor.SCENES["gap"]
    seen = break_sensor.run(gap, break_sensor.average())
    first = max(gap.lost)
    return {
        "kalman": AXES * burden.total(burden.kalman(2, 1)),
        "constant": AXES * burden.total(burden.steady_state(2, 1)),
        "settled": break_sensor.settled(),
        "lost": len(gap.lost),
        "sigma": f"{seen.sigma[first]:.2f}",
        "sigma_constant": f"{seen.sigma_constant[first]:.2f}",
    }


def outcomes(given):
    """Return how all items of a paper come out, as Outcomes that add up."""
    counts = {words: sum(each.verdict in some for each in given) for words, some in WORDS.items()}
    return [Outcome(WORDS[words][0], words, count) for words, count in counts.items() if count]
