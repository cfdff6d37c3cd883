"""The table of real recordings: files, base, truth, and what has been compared on them.

Folders lie in `${GRAPHFIX_DATA:-../shared/data}`. Positions are ECEF (m) unless said otherwise.
"""

import os
from dataclasses import dataclass

from .positions import Truth, to_ecef

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
DATA = os.environ.get("GRAPHFIX_DATA", os.path.join(ROOT, "..", "shared", "data"))

CITY, OPEN, PHONE, WALK = "city", "open", "phone", "walk"
ALONE = ("spp", "ekf", "fgo")
RELATIVE = ("rtk-ekf", "rtk-fgo")


@dataclass(frozen=True)
class Recording:
    """One drive: its files and how it is judged."""

    name: str
    folder: str
    rover: str
    navigation: tuple[str, ...]
    # Surroundings: city, open, phone (a phone's receiver, in a city) or walk.
    kind: str
    # Whether settings have been compared on it.
    is_compared: bool
    base: str | None = None
    base_position: tuple | None = None
    truth_file: str | None = None
    truth_place: tuple | None = None
    # From the reference point to the antenna, east, north, up (m).
    lever: tuple | None = None
    # Standard deviation per horizontal axis of the truth itself (m).
    truth_sigma_m: float = 0.0
    # First and last second of week solved.
    span: tuple | None = None
    # A fix with a larger error is wrong (m, 2D).
    wrong_m: float = 0.1
    # RINEX 3 version of the same rover, where `rover` is none, for faults.
    rinex3: str | None = None
    modes: tuple[str, ...] = ALONE

    def path(self, name):
        return os.path.join(self.folder, name)

    def truth(self):
        """The truth; None where there is none."""
        if self.truth_place:
            return Truth.fixed(self.truth_place, self.lever)
        return Truth.read(self.path(self.truth_file), self.lever) if self.truth_file else None

    def is_there(self):
        return os.path.exists(self.path(self.rover))


def _real(name, rover, navigation, kind, *, folder=None, **rest):
    place = os.path.join(DATA, folder or name)
    # Settings have been compared on every recording.
    return Recording(name, place, rover, tuple(navigation), kind, True, **rest)


HONG_KONG = [f"hkqt137c.21{kind}" for kind in "cglnq"]
# The truth is the inertial unit's point, the antenna some 0.9 m away in a direction that turns
# with the car: 0.9 m/√2 per axis.
HONG_KONG_SIGMA_M = 0.64
SPIRENT_BASE = (4157177.06580187, 671230.476590636, 4774767.03105544)
SHANGHAI_BASE = (-2845676.411, 4661619.4022, 3283215.3241)


def _hong_kong(receiver, kind):
    return _real(
        f"urbannav-tst-{receiver}", f"{receiver}.obs.gz", HONG_KONG, kind, folder="urbannav-tst",
        truth_file="truth.csv", truth_sigma_m=HONG_KONG_SIGMA_M,
    )


def _spirent(name, rover, **truth):
    return _real(
        name, rover, ["RINEX_GN_Spirent.23N", "RINEX_EN_Spirent.23L"], OPEN, folder="spirent-rtk",
        base="Base-static_MO_Spirent.obs", base_position=SPIRENT_BASE,
        truth_sigma_m=0.001, modes=ALONE + RELATIVE, **truth,
    )


def _shanghai(name, rover, base, navigation):
    # 0.19 m of the truth turn with the body: 0.19/√2 per axis.
    return _real(
        name, rover, [navigation], WALK, folder="shanghai-walk", base=base, base_position=SHANGHAI_BASE,
        truth_file="truth.csv", lever=(-0.33, -1.92, 1.87), truth_sigma_m=0.14, wrong_m=0.5,
        modes=ALONE + RELATIVE,
    )


ALL = [
    _real(
        "tst-2019", "COM3_190428_124409.obs", ["hksc1180.19n", "hksc1180.19b"], CITY,
        truth_file="truth.csv", truth_sigma_m=0.3, span=(46701.0, 47185.5),
    ),
    _real(
        "berlin", "rover.obs.gz", ["brdc1580.16n", "brdc1580.16g"], CITY, truth_file="truth.csv",
        truth_sigma_m=0.3, rinex3="rover-rinex3.obs.gz",
    ),
    _hong_kong("ublox.f9p", CITY),
    _hong_kong("ublox.f9p.splitter", CITY),
    _hong_kong("novatel.flexpak6", CITY),
    _hong_kong("ublox.m8t.GC", CITY),
    _hong_kong("ublox.m8t.GEJ", CITY),
    _hong_kong("ublox.m8t.GR", CITY),
    _hong_kong("google.pixel4", PHONE),
    _hong_kong("huawei.p40pro", PHONE),
    _hong_kong("samsung.note8", PHONE),
    _hong_kong("xiaomi.mi8", PHONE),
    # The phone's antenna is about a metre from that of the truth. So it is in the next recording.
    _real(
        "mobile-street", "rover.obs.gz", ["rover.nav.gz"], PHONE, truth_file="truth.csv", truth_sigma_m=0.7,
    ),
    _real("gsdc-pixel4", "rover.obs.gz", ["hour1350.20n"], PHONE, truth_file="truth.csv", truth_sigma_m=0.7),
    _real(
        "klt-2021", "20210610.klt1.ublox.f9p.obs", ["hksc1610.nav"], CITY,
        base="hksc1610.obs", base_position=(-2414266.9197, 5386768.9868, 2407460.0314), modes=ALONE + RELATIVE,
    ),
    # The truth is the receiver's own fix on a grid of 2 cm: 2 cm/√12, and 1 cm of its own.
    _real(
        "galway-static", "rover-20181004-1237.obs.gz", ["rover-20181004-1237.ubx.nav"], OPEN,
        base="base-20181004-1236.obs.gz",
        base_position=(3774089.212, -601661.6157, 5089321.2474), truth_file="truth.csv", truth_sigma_m=0.012,
        modes=ALONE + RELATIVE,
    ),
    _real(
        "galway-walk", "rover-20181004-1532.obs.gz", ["rover-20181004-1532.ubx.nav"], WALK,
        base="base-20181004-1452.obs.gz",
        base_position=(3774085.6456, -601662.5769, 5089316.397), truth_file="truth.csv", truth_sigma_m=0.012,
        modes=ALONE + RELATIVE,
    ),
    _real(
        "hers-hert", "hers0010.18O", ["brdc0010.18n"], OPEN, base="hert0010.18O",
        base_position=(4033460.7531, 23538.0162, 4924318.3881),
        truth_place=(4033469.9337, 23673.1031, 4924301.4433), truth_sigma_m=0.003, modes=ALONE + RELATIVE,
    ),
    _real(
        "geonet", "07590920.05o", ["30400920.05n"], OPEN, base="30400920.05o",
        base_position=(-3978241.958, 3382840.234, 3649900.853), modes=ALONE + RELATIVE,
    ),
    _real(
        "meijo-static", "rover.obs", ["base.nav"], OPEN, base="base.obs",
        base_position=to_ecef(35.134707705, 136.977577939, 104.853),
        truth_place=to_ecef(35.13469901, 136.97757549, 104.8626), truth_sigma_m=0.002, modes=ALONE + RELATIVE,
    ),
    _real(
        "fujisawa-kinematic", "SEPT265G.21O", ["SEPT2650.21P"], OPEN, base="3034265G.21O",
        base_position=(-3959400.631, 3385704.533, 3667523.111), modes=ALONE + RELATIVE,
    ),
    _spirent("spirent-dynamic", "Rover-dynamic_MO_Spirent.obs", truth_file="truth-dynamic.csv"),
    _spirent(
        "spirent-static", "Rover-static-2km-east_MO_Spirent.obs",
        truth_place=(4156857.1195929, 673209.028774142, 4774767.03105544),
    ),
    _shanghai("shanghai-walk", "rover.rtcm3", "base.rtcm3", "rover.rtcm3"),
    _shanghai("shanghai-walk-convbin", "rover-convbin.obs.gz", "base-convbin.obs.gz", "rover.nav"),
]


def select(names):
    """The recordings whose name contains one of `names`; all recordings without names."""
    return [one for one in ALL if not names or any(name in one.name for name in names)]
