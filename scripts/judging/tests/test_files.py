"""Reading and writing of RINEX, solutions and truth."""

import math
import os
import tempfile
import unittest

from judging import positions, rinex
from judging.runs import Method

HEADER = [
    "     3.04           OBSERVATION DATA    M                   RINEX VERSION / TYPE",
    "G    4 C1C L1C D1C S1C                                      SYS / # / OBS TYPES ",
    "R    2 C1C L1C                                              SYS / # / OBS TYPES ",
    "  2 R01  1 R02 -4                                           GLONASS SLOT / FRQ #",
    "                                                            END OF HEADER       ",
]
BODY = [
    "> 2019 04 28 12 58 21.0030000  0  2",
    "G05  22187868.655 7 116598092.98637      2141.540          43.000",
    "R02  19987868.655",
    "> 2019 04 28 12 58 22.0030000  4  1",
    "A COMMENT                                                   COMMENT",
    "> 2019 04 28 12 58 23.0030000  0  1",
    "G 5                 116598092.9861",
]


class Files(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()

    def tearDown(self):
        self.folder.cleanup()

    def path(self, name, lines):
        path = os.path.join(self.folder.name, name)
        with open(path, "w", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
        return path

    def test_rinex_comes_back_as_it_was_without_events(self):
        observations = rinex.read(self.path("a.obs", HEADER + BODY))
        self.assertEqual([len(epoch.satellites) for epoch in observations.epochs], [2, 1])
        value = observations.epochs[0].satellites[0].values["L1C"]
        self.assertEqual(value, rinex.Value(116598092.986, "3", "7"))
        copy = os.path.join(self.folder.name, "b.obs")
        rinex.write(copy, observations)
        with open(copy, encoding="utf-8") as file:
            written = file.read().split("\n")
        expected = HEADER + BODY[:3] + [BODY[5], BODY[6].replace("G 5", "G05")]
        self.assertEqual([line.rstrip() for line in written[:-1]], [line.rstrip() for line in expected])

    def test_times_are_gps_seconds(self):
        observations = rinex.read(self.path("a.obs", HEADER + BODY))
        # Week 2051 began on 2019-04-28, a Sunday; 12 h 58 min 21.003 s later.
        self.assertAlmostEqual(observations.epochs[0].time, 2051 * 604_800 + 46_701.003, 6)

    def test_wavelengths_follow_the_channel(self):
        observations = rinex.read(self.path("a.obs", HEADER + BODY))
        self.assertAlmostEqual(observations.wavelength_m("R02", "L1C"), 299_792_458.0 / 1_599.75e6)
        self.assertAlmostEqual(observations.wavelength_m("G05", "L1C"), 0.190_293_7, 6)

    def test_rinex_2_is_refused(self):
        with self.assertRaises(rinex.UnsupportedFile):
            rinex.read(self.path("a.obs", ["     2.11           OBSERVATION DATA"]))

    def test_the_last_position_of_a_time_counts(self):
        lines = [
            "gps_week,tow_s,status,x_m,y_m,z_m,var_e_m2,var_n_m2,cov_en_m2,fix_probability",
            "2051,46701.003,SINGLE,1,2,3,4,5,6,",
            "2051,46701.003,FIXED,7,8,9,4,5,6,0.99",
            "2051,46701.003,NONE,,,,,,,",
            "2051,46700,NONE,,,,,,,",
        ]
        none, answer = positions.read_answers(self.path("a.csv", lines))
        self.assertEqual((none.status, none.place), ("NONE", None))
        self.assertEqual((answer.place, answer.probability), ((7.0, 8.0, 9.0), 0.99))
        self.assertEqual((answer.covariance, answer.protection), ((4.0, 5.0, 6.0), None))

    def test_truth_is_interpolated_but_not_over_gaps(self):
        lines = ["gps_week,tow,x,y,z", "0,10,6378137,0,0", "0,11,6378137,2,0", "0,20,6378137,4,0"]
        truth = positions.Truth.read(self.path("truth.csv", lines))
        self.assertEqual(truth.at(10.25), (6378137.0, 0.5, 0.0))
        self.assertEqual(truth.at(19.985), (6378137.0, 4.0, 0.0))
        self.assertEqual((truth.at(15.0), truth.at(9.9)), (None, None))

    def test_a_fixed_truth_holds_at_all_times(self):
        truth = positions.Truth.fixed((6378137.0, 0.0, 0.0), lever=(1.0, 0.0, 2.0))
        self.assertEqual(truth.at(123.0), (6378139.0, 1.0, 0.0))

    def test_east_north_up_on_the_equator_and_at_the_pole(self):
        equator = (6378137.0, 0.0, 0.0)
        self.assertEqual(positions.to_enu((6378140.0, 1.0, 2.0), equator), (1.0, 2.0, 3.0))
        place = positions.to_ecef(35.0, 137.0, 100.0)
        shifted = positions.moved(place, (1.0, -2.0, 3.0))
        for found, wanted in zip(positions.to_enu(shifted, place), (1.0, -2.0, 3.0)):
            self.assertAlmostEqual(found, wanted, 6)
        # The semi-minor axis of WGS 84.
        self.assertAlmostEqual(positions.to_ecef(90.0, 0.0, 0.0)[2], 6_356_752.314_2, 3)
        self.assertTrue(math.isclose(positions.to_ecef(0.0, 90.0, 5.0)[1], 6_378_142.0))

    def test_methods_by_name(self):
        method = Method.parse("fgo:batch@urban-vehicle")
        self.assertEqual((method.mode, method.way, method.profile), ("fgo", "batch", "urban-vehicle"))
        self.assertEqual(str(method), "fgo:batch@urban-vehicle")
        self.assertEqual(str(Method.parse("fgo")), "fgo")


if __name__ == "__main__":
    unittest.main()
