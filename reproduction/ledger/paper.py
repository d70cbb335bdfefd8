"""The verdicts on one paper: computed from what a notebook found, never typed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from numbers import Real

import numpy as np

from .contents import Row
from .items import About, Cause, Item, printed_of
from .shown import Grid, Layout, Shown, beside, laid_out, mark, place, shortened
from .tables import gap_text
from .verdicts import (
    BASES,
    CANNOT_BE_CHECKED,
    DIFFERS,
    ERRATUM,
    FAILS,
    HOLDS,
    IN_PART,
    REPRODUCED,
    WITHIN_BAND,
    Verdict,
    Verdicts,
    counted,
)


class Paper:
    """The items of one paper, the causes of what fails, and the verdicts given so far; made by `published`."""

    def __init__(
        self,
        key: str,
        items: Iterable[Item],
        causes: Iterable[Cause],
        about: About | None = None,
        layouts: Iterable[Layout] = (),
        rows: Iterable[Row] = (),
    ):
        self.key, self.about = key, about
        self.items = {item.id: item for item in items}
        self.causes = {cause.id: cause for cause in causes}
        self.layouts = {layout.id: layout for layout in layouts}
        self.rows = list(rows)
        self._outcomes = {}  # the last verdict on each item, in a word
        self._to_report = []
        self._told_at = {}  # where the sentence of a cause was shown first

    def check(
        self,
        id: str,
        value: float,
        *,
        basis: str = "arithmetic",
        band: tuple[float, float] | None = None,
        reason: str = "",
    ) -> Verdict:
        """Compare a computed number with the printed one, and return the Verdict.

        Without a band it is `reproduced` when it rounds to the printed digits. With a band (low, high), the spread of
        simulations, it is `within band` when the printed number lies inside. Otherwise it `differs`, or is an `erratum`
        if the item is `against` others of the paper from which the value follows and which were reproduced: then the
        paper contradicts itself. An item that fails needs a cause; its sentence is the reason unless you give one.
        Raises ValueError for an argument that makes no sense, naming the item.
        """
        item = self._item(id, ["number"])
        if not _is_finite(value):
            raise self._error(id, f"needs a finite number, got {value!r}")
        computed = f"{value:.6g}"
        if band is None:
            verdict = REPRODUCED if item.agrees(value) else DIFFERS
        else:
            if np.shape(band) != (2,) or not all(map(_is_finite, band)) or band[0] > band[1]:
                raise self._error(id, f"needs a band (low, high) of finite numbers with low <= high, got {band!r}")
            if basis in ("identity", "arithmetic", "reading"):
                raise self._error(id, f"needs the basis of its band: exact, simulation or recording, got {basis!r}")
            low, high = band
            verdict = WITHIN_BAND if low <= float(item.printed) <= high else DIFFERS
            computed += f" [{low:.6g}, {high:.6g}]"
        return self._give(item, computed, verdict, basis, reason)

    def claim(
        self,
        id: str,
        holds: bool | np.bool_ | Mapping[str, bool | np.bool_],
        evidence: str,
        *,
        basis: str = "",
        reason: str = "",
        beyond: str = "",
    ) -> Verdict:
        """Record whether a claim, a formula or what a figure shows holds, with the evidence, and return the Verdict.

        holds is a bool, or a mapping {condition in words: bool}. It is `reproduced` when all hold and `holds in part`
        when some do; the verdict names the conditions. When none holds, it `differs` or is an `erratum`, as in `check`.
        A condition lies inside the setting that the paper states or evidently means. What was found outside it (other
        starts, steps, recordings) is beyond: a sentence that stands beside the verdict, and never changes it.
        """
        item = self._item(id, ["formula", "claim", "figure"])
        conditions = holds if isinstance(holds, Mapping) else {}
        outcomes = list(conditions.values()) or [holds]
        if not all(isinstance(outcome, (bool, np.bool_)) for outcome in outcomes):
            raise self._error(id, f"needs True, False or {{condition: True or False}}, got {holds!r}")
        if all(outcomes):
            verdict = REPRODUCED
        elif any(outcomes):
            verdict = IN_PART
        else:
            verdict = DIFFERS
        where_it_holds = "; ".join(condition for condition in conditions if conditions[condition])
        where_it_fails = "; ".join(condition for condition in conditions if not conditions[condition])
        prefix = ""
        if where_it_holds:
            prefix += f"Holds: {where_it_holds}. "
        if where_it_fails:
            prefix += f"Does not hold: {where_it_fails}. "
        return self._give(item, evidence, verdict, basis, reason, prefix, beyond)

    def cannot_check(self, id: str, missing: str, *, counted: float | None = None) -> Verdict:
        """Record that an item cannot be checked, and what is missing.

        An item that our copy of the paper has lost has a cause of kind "copy", and no other. counted is the number that
        should stand there, where it is known.
        """
        item = self._item(id)
        if counted is not None and not _is_finite(counted):
            raise self._error(id, f"needs a finite number for counted, got {counted!r}")
        lost_by_us = [each.id for each in self.causes.values() if each.kind == "copy"]
        if (item.lost or item.cause) and item.cause not in lost_by_us:
            raise self._error(id, f'needs a cause of kind "copy", or none if our copy has the item, got {item.cause!r}')
        computed = "-" if counted is None else f"{counted:.6g}"
        return self._give(item, computed, CANNOT_BE_CHECKED, "reading", missing)

    def table(
        self, id: str, computed, *, basis: str = "", reason: str = "", extra: Mapping[str, Iterable] | None = None
    ) -> Shown:
        """Check all cells of a table of the paper; return it as the paper lays it out, printed beside computed.

        computed maps the items' ids to values, or has the values in reading order (of a grid, the whole array).
        A value is a number; (number, (low, high)) with the band of simulations; for a formula or a text (whether it
        holds, as in `claim`, what is right, how that was seen), or a function of the printed text that returns these;
        or a text that says why it cannot be checked. Cells that our copy has lost are shown and not judged. reason is
        that of all numbers, such as the reading by which they are judged. extra has columns of ours for the right,
        {head: cells}.
        """
        layout = self.layouts[id]
        if not isinstance(computed, Mapping):
            values = _where_items_stand(layout, computed) if layout.grid else computed
            computed = dict(zip(layout.ids, values, strict=True))
        items = [self.items[each] for each in layout.ids]
        decimals = max((item.decimals for item in items if item.kind == "number"), default=0)  # of what is lost
        cells = {item.id: self._cell(item, computed[item.id], basis, reason, layout.grid, decimals) for item in items}
        caption = layout.title
        if layout.ids:
            caption += f". {_agreeing(self._to_report)}."
        head, *rows = laid_out(layout, cells, extra)
        return self._shown(Grid(head, rows, caption), self._told(layout))

    def equal(self, gaps: Mapping[str, float], what: str = "", *, below: float = 1e-12, reason: str = "") -> Shown:
        """Record formulas and claims that hold if a gap is rounding, {id: gap}, and show them in a table.

        what says between which two things the gap is.
        """
        rows = []
        for id, gap in gaps.items():
            size = gap_text(gap, below)
            evidence = f"{what}: largest gap {size}" if what else f"largest gap {size}"
            given = self.claim(id, bool(gap < below), evidence, basis=self._item(id).basis or "identity", reason=reason)
            rows.append([place(given), shortened(given.printed), size])
        head = ["", "the paper says", "largest gap" + (f" to {what}" if what else "")]
        return self._shown(Grid(head, rows, sentences=True))

    def claims(self, found: Mapping[str, tuple], *, basis: str = "") -> Shown:
        """Record claims and formulas, and show them in a table: {id: (holds, evidence[, beyond])}, as in `claim`."""
        rows = []
        for id, (holds, evidence, *beyond) in found.items():
            given = self.claim(id, holds, evidence, basis=basis, beyond=" ".join(beyond))
            rows.append([place(given), given.printed, evidence])
        return self._shown(Grid(["", "the paper says", "what we find"], rows, sentences=True))

    def lacking(self, missing: Mapping[str, str], *, folded: str = "") -> Shown:
        """Record what cannot be checked, {id: what is missing}, and show it in a table, folded under a text if any."""
        rows = []
        for id, what in missing.items():
            given = self.cannot_check(id, what)
            rows.append([place(given), given.printed, what])
        return self._shown(Grid(["", "what cannot be checked", "why"], rows, sentences=True), folded=folded)

    def _cell(self, item, value, basis, reason, grid, decimals):
        """Check one cell of a table, and return it as it is shown."""
        if callable(value):
            value = value(item.printed)
        if isinstance(value, str):
            given, right = self.cannot_check(item.id, value), ""
        elif item.lost:
            right = f"{value:.{decimals}f}"
            given = self.cannot_check(item.id, "our copy has lost this cell", counted=float(right))
        elif isinstance(value, tuple) and isinstance(value[0], (bool, np.bool_, Mapping)):
            holds, right, how = value
            evidence = how if right == item.printed else f"{right}: {how}"
            given = self.claim(item.id, holds, evidence, basis=basis or item.basis or "arithmetic")
        else:
            value, band = value if isinstance(value, tuple) else (value, None)
            basis = basis or item.basis or "arithmetic"
            given = self.check(item.id, float(value), basis=basis, band=band, reason=reason)
            right = f"{value:.{item.decimals}f}"
            if band:
                right += f" ({band[0]:.{item.decimals}f} to {band[1]:.{item.decimals}f})"
        return beside(given, right, grid)

    def _told(self, layout):
        """Return what is wrong in a table, a sentence for each cause or one for all; none is told twice."""
        failing = [each for each in self._to_report if each.verdict in FAILS]
        if layout.wrong and failing:
            told = [f"{_signed(failing)}: {layout.wrong}"]
        else:
            told = []
            for cause in dict.fromkeys(each.cause for each in failing):
                cells = [each for each in failing if each.cause == cause]
                told.append(f"{_signed(cells)}: {self._why(cause, layout.name)}")
        unchecked = [each for each in self._to_report if each.verdict == CANNOT_BE_CHECKED and each.printed != "?"]
        for reason, count in Counter(each.reason for each in unchecked).items():
            told.append(f"{mark(CANNOT_BE_CHECKED)} {counted(count, 'cell')}: {reason}.")
        return told

    def _why(self, cause, here):
        """Return the sentence of a cause, or where it was told before."""
        told_at = self._told_at.setdefault(cause, here)
        return self.causes[cause].sentence if told_at == here else f"As in {told_at}."

    def _shown(self, grid, told=None, folded=""):
        """Return what a cell shows: a table, and below it what is wrong; of claims, the reason of each that fails."""
        if told is None:
            told = []
            for each in self._to_report:
                if each.verdict in FAILS:
                    reason = each.reason.replace(self.causes[each.cause].sentence, self._why(each.cause, each.where))
                    told.append(f"{mark(each.verdict)} {reason}")
            told = list(dict.fromkeys(told))
        given, self._to_report = self._to_report, []
        return Shown(given, self.causes_by_paper(), grid, told, folded)

    def report(self) -> Verdicts:
        """Return the Verdicts given since the last report; as the last line of a cell, it shows and stores them."""
        if not self._to_report:
            raise ValueError(f"{self.key}: no verdict was given since the last report")
        given = Verdicts(self._to_report, self.causes_by_paper())
        self._to_report = []
        return given

    def complete(self, verdicts: Verdicts) -> Verdicts:
        """Return these Verdicts if they cover the paper: each item once, as in the file, each failure with its cause.

        Raises ValueError otherwise, naming the entries.
        """
        times = Counter(each.id for each in verdicts)
        named = {each.cause for each in verdicts if each.cause}
        failing = [each.id for each in verdicts if each.verdict in FAILS and not each.cause]
        printed = {printed_of(item) for item in self.items.values()}
        changed = [each.id for each in verdicts if (each.id, each.where, each.kind, each.printed) not in printed]
        wrong = {
            "no verdict on": [id for id in self.items if id not in times],
            "no cause, although it fails, for": failing,
            "two verdicts on": [id for id in times if times[id] > 1],
            "verdicts that do not match the file (unknown id or changed text):": changed,
            "no verdict names the cause": [id for id in self.causes if id not in named],
        }
        parts = [f"{what} {', '.join(ids)}" for what, ids in wrong.items() if ids]
        if parts:
            raise ValueError(f"{self.key}.toml and its notebook: {'; '.join(parts)}")
        return verdicts

    def causes_by_paper(self) -> dict[tuple[str, str], Cause]:
        """Return the causes as {(key of the paper, id): Cause}, as Verdicts take them."""
        return {(self.key, id): cause for id, cause in self.causes.items()}

    def _item(self, id, kinds=None):
        """Return an item; if kinds are named, one of these kinds that our copy of the paper has not lost."""
        if id not in self.items:
            near = get_close_matches(str(id), self.items, n=3, cutoff=0)
            raise self._error(id, f"unknown id of {self.key}.toml; did you mean {', '.join(near)}?")
        item = self.items[id]
        if kinds and item.kind not in kinds:
            raise self._error(id, f"needs an item of kind {' or '.join(kinds)}, got a {item.kind}")
        if kinds and item.lost:
            raise self._error(id, "our copy has lost this item: use cannot_check")
        return item

    def _give(self, item, computed, verdict, basis, reason, prefix="", beyond=""):
        """Return the Verdict and keep it for the report; what holds has no cause, what fails has its sentence."""
        basis = basis or item.basis
        if basis not in BASES:
            raise self._error(item.id, f"needs one of the bases {', '.join(BASES)}, got {basis!r}")
        if verdict in FAILS:
            self._require_cause(item, verdict, computed)
        cause = "" if verdict in HOLDS else item.cause
        if cause:
            reason = reason or self.causes[cause].sentence
        if verdict == DIFFERS and item.against:
            verdict = ERRATUM
            sides = "; ".join(f"{self.items[id].where}: {self.items[id].printed}" for id in item.against)
            reason = f"{reason} Against {sides}."
        reason = (prefix + reason).strip()
        given = Verdict(self.key, *printed_of(item), computed, verdict, reason, basis, cause, beyond)
        self._outcomes[item.id] = verdict
        self._to_report.append(given)
        return given

    def _require_cause(self, item, verdict, computed):
        """Raise unless an item that fails has a cause of ours, and what it is against was reproduced before."""
        if not item.cause:
            raise self._error(item.id, f"needs a cause, since the verdict is {verdict!r} (computed: {computed})")
        if self.causes[item.cause].kind == "copy":
            need = "needs another cause: what our copy has lost cannot be checked"
            raise self._error(item.id, f"{need}, got {item.cause!r}")
        for id in item.against:
            if self._outcomes.get(id) != REPRODUCED:
                raise self._error(item.id, f"needs items in `against` that were reproduced before, got {id!r}")

    def _error(self, id, problem):
        return ValueError(f"{self.key}, {id!r}: {problem}")


def _agreeing(verdicts):
    """Return in words how many of a table's cells agree."""
    times = Counter(each.verdict for each in verdicts)
    unchecked, lost = times[CANNOT_BE_CHECKED], sum(each.printed == "?" for each in verdicts)
    how = "within the band" if times[WITHIN_BAND] and not times[REPRODUCED] else "agree"
    said = f"{sum(times[each] for each in HOLDS)} of {len(verdicts) - unchecked} {how}"
    if times[IN_PART]:
        said += f", {times[IN_PART]} in part"
    if lost:
        said += f"; our copy has lost {lost}"
    if unchecked > lost:
        said += f"; {unchecked - lost} cannot be checked"
    return said


def _signed(failing):
    """Return the number of failing cells behind each sign, as in "✗ 1 cell, (✓) 2 cells"."""
    signs = Counter(mark(each.verdict) for each in failing)
    return ", ".join(f"{sign} {counted(signs[sign], 'cell')}" for sign in ("✗", "(✓)") if signs[sign])


def _where_items_stand(layout, lines):
    """Return the values of a grid, in the order of its items, from lines of one value for each cell."""
    values = []
    for row, line in zip(layout.rows, lines, strict=True):
        values += [value for cell, value in zip(row[1:], line, strict=True) if cell]
    return values


def _is_finite(value):
    return isinstance(value, Real) and math.isfinite(value)
