#!/usr/bin/env bash
# Guess, written before it was tried: xarray opens a NetCDF file whose time has one of the calendars in which the CF
# conventions count SI seconds over leap seconds, "utc" or "tai".
#
# Versions: xarray 2026.9.0, cftime 1.6.5, netCDF4 1.7.4, from PyPI.
# Source: CF conventions 1.12, section 4.4.3 "Leap Seconds" and example 4.5: of 2 "seconds since 2016-12-31 23:59:58"
# the calendar "utc" makes 23:59:60 of that day, "tai" 2017-01-01 00:00:00 (TAI), "standard" 2017-01-01 00:00:00.
#
# Behaviour: with either the file cannot be opened with times decoded, as cftime knows no such calendar. "standard", which
# counts no leap second whatever "units_metadata" says, is opened; a count of SI seconds in it has right lengths of time,
# and dates that are a second late behind a leap second.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -q xarray==2026.9.0 cftime==1.6.5 netCDF4==1.7.4
cd "$work"
"$work/venv/bin/python" - <<'PYTHON'
import netCDF4
import xarray

seen = {}
for calendar, more in (("utc", ""), ("tai", ""), ("standard", "leap_seconds: utc"), ("standard", "leap_seconds: none")):
    with netCDF4.Dataset("x.nc", "w") as file:
        file.Conventions = "CF-1.12"
        file.createDimension("time", 2)
        time = file.createVariable("time", "f8", ("time",))
        time.standard_name, time.units, time.calendar = "time", "seconds since 2016-12-31 23:59:58", calendar
        if more:
            time.units_metadata = more
        time[:] = [2.0, 3.0]
    try:
        with xarray.open_dataset("x.nc") as opened:
            seen[calendar, more] = [str(t)[:19] for t in opened["time"].values]
    except Exception as error:
        seen[calendar, more] = "not opened"
        print(f"  {type(error).__name__}: {str(error).splitlines()[0][:150]}")
    print(calendar, more or "-", seen[calendar, more])
late = ["2017-01-01T00:00:00", "2017-01-01T00:00:01"]
expected = {
    ("utc", ""): "not opened", ("tai", ""): "not opened",
    ("standard", "leap_seconds: utc"): late, ("standard", "leap_seconds: none"): late,
}
raise SystemExit(0 if seen == expected else "the behaviour has changed")
PYTHON
