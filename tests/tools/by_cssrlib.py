"""Make tests/rinex/by_cssrlib.csv: orbits, clocks and delays of the recorded days by cssrlib, no code of ours.

    python -m pip install cssrlib==1.2.1 hatanaka==2.8.1 georinex==1.16.2
    python tests/tools/by_cssrlib.py OBSERVATIONS.crx.gz NAVIGATION.rnx.gz esbc_2020_177 [BIASES.BSX]

It runs where cssrlib is installed, once for each station, and writes that station's lines. The tests read the file and
need none of these packages. For every 193rd epoch and each GPS satellite above 10 degrees a line holds, in metres: C1C,
the distance from the station with the turn of the Earth, the satellite's clock, the group delay, the ionosphere
(Klobuchar), the troposphere (zenith delays of Saastamoinen, half saturated, over the sine of the elevation, and by
the mapping functions of Niell, which cssrlib uses itself), the bias C1C - C1W of a Bias-SINEX file, without one the
day's mean, and the elevation in degrees. georinex only reads the observations.
"""

import argparse
import csv
import gzip
import tempfile
import warnings
from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "rinex" / "by_cssrlib.csv"
COLUMNS = ["table", "epoch", "satellite", "measured", "distance", "clock", "group", "ionosphere"]
COLUMNS += ["troposphere", "niell", "bias", "elevation"]
EVERY = 193  # epochs: none lies as far from one message as from the next, where either may be taken


def gps_only(path, folder):
    """Write the GPS part of a navigation file: cssrlib takes QZSA, where a file has it, for GPS's ionosphere."""
    text = gzip.decompress(path.read_bytes()).decode()
    head, end, body = text.partition("END OF HEADER")
    head = "\n".join(line for line in head.splitlines() if not line.startswith("QZS")) + "\n" + " " * 60
    if head.rstrip().endswith("IONOSPHERIC CORR") or "END OF HEADER" not in text:
        raise SystemExit(f"{path}: needs a header that ends")
    keep, blocks = False, []
    for line in body.splitlines()[1:]:
        if line[:1].strip():
            keep = line.startswith("G")
        if keep:
            blocks.append(line)
    out = Path(folder) / "gps.rnx"
    head = head[: head.rindex("\n")]
    out.write_text(f"{head}\n{'':60}{end}\n" + "\n".join(blocks) + "\n", encoding="ascii")
    return out


def lines_of(observations, navigation, table, biases):
    """Return the lines of one station."""
    import georinex
    from cssrlib import gnss
    from cssrlib.ephemeris import eph2clk, eph2pos, eph2rel, findeph
    from cssrlib.peph import biasdec
    from cssrlib.pntpos import ionKlobuchar
    from cssrlib.rinex import rnxdec

    nav = gnss.Nav()
    with tempfile.TemporaryDirectory() as folder:
        nav = rnxdec().decode_nav(gps_only(navigation, folder), nav)
    known = biasdec()
    if biases is not None:
        known.parse(str(biases))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        seen = georinex.load(observations, use="G", meas=["C1C", "C1W"])
    station = np.array(seen.attrs["position"])
    place = gnss.ecef2pos(station)
    lines = []
    for when in seen["time"].values[::EVERY]:
        at = when.astype("datetime64[ms]").item()
        t = gnss.epoch2time([at.year, at.month, at.day, at.hour, at.minute, at.second])
        midnight = when.astype("datetime64[D]")
        for name in seen.sv.values:
            measured = float(seen["C1C"].sel(sv=name, time=when))
            sat = gnss.id2sat(str(name))
            eph = findeph(nav.eph, t, sat)
            if not measured > 0 or eph is None or eph.svh:
                continue
            left = gnss.timeadd(t, -measured / gnss.rCST.CLIGHT)
            left = gnss.timeadd(left, -eph2clk(left, eph))
            position, _ = eph2pos(left, eph)
            distance, toward = gnss.geodist(position, station)
            azimuth, elevation = gnss.satazel(place, toward)
            if np.degrees(elevation) <= 10:
                continue
            dry, wet, _ = gnss.tropmodel(t, place, humi=0.5)
            one, other = gnss.tropmapf(t, place, elevation)
            clock = gnss.rCST.CLIGHT * (eph2clk(left, eph) + eph2rel(left, eph))
            found = [gnss.rCST.CLIGHT * 1e-9 * each.bias for each in known.dcb if each.sat == sat]
            if biases is None:
                found = [np.nanmean((seen["C1C"] - seen["C1W"]).sel(sv=name))]
            lines.append([
                table,
                f"{(when - midnight) / np.timedelta64(1, 's'):g}",
                int(name[1:]),
                *(
                    f"{each:.4f}"
                    for each in (
                        measured,
                        distance,
                        clock,
                        gnss.rCST.CLIGHT * eph.tgd,
                        ionKlobuchar(t, place, azimuth, elevation, nav.ion),
                        (dry + wet) / np.sin(elevation),
                        one * dry + other * wet,
                        found[0] if found else np.nan,
                        np.degrees(elevation),
                    )
                ),
            ])  # fmt: skip
    return lines


def main():
    """Read the files that the command line names and replace the lines of that table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("observations", type=Path)
    parser.add_argument("navigation", type=Path)
    parser.add_argument("table")
    parser.add_argument("biases", type=Path, nargs="?")
    names = parser.parse_args()
    lines = lines_of(names.observations, names.navigation, names.table, names.biases)
    kept = []
    if FILE.exists():
        with FILE.open(encoding="utf-8", newline="") as file:
            kept = [row for row in list(csv.reader(file))[1:] if row[0] != names.table]
    with FILE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *sorted(kept + lines)])
    print(f"{FILE}: {len(lines)} lines of {names.table}")


if __name__ == "__main__":
    main()
