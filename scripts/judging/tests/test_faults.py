"""What each fault does, on a recording whose every number is known."""

import unittest

from judging import faults
from judging.rinex import SPEED_OF_LIGHT, Value

from .files import START, recording, series


def late(changed, name, code):
    """The extra length of a pseudorange (m) for each time after the start (s)."""
    clean = series(recording(), name, code)
    return {
        time: round(reading.number - clean[time].number, 6)
        for time, reading in series(changed, name, code).items()
        if reading
    }


class Faults(unittest.TestCase):
    def inject(self, *texts, seed=1, **how):
        return faults.inject(recording(**how), texts, seed)

    def test_the_same_seed_gives_the_same_and_another_seed_another(self):
        texts = "reflect=0.3", "wild=0.02", "slips=600", "half=600", "gaps=2", "shuffle"
        first, second, other = (self.inject(*texts, seed=seed)[0] for seed in (3, 3, 4))
        self.assertEqual(first, second)
        self.assertNotEqual(first, other)

    def test_what_one_fault_draws_does_not_depend_on_the_others(self):
        alone, _ = self.inject("bad-start=20")
        beside, _ = self.inject("bad-start=20", "slips=600")
        self.assertEqual(late(alone, "G01", "C1C"), late(beside, "G01", "C1C"))

    def test_unknown_names_and_values_are_refused(self):
        for text in ("bad-start", "steps=3", "rain=1"):
            with self.assertRaises(faults.UnknownFault):
                self.inject(text)

    def test_cut_and_thin_keep_times(self):
        changed, spans = self.inject("cut=10:30", "thin=5")
        self.assertEqual([epoch.time - START for epoch in changed.epochs], [10, 15, 20, 25, 30, 35])
        self.assertEqual(spans, [])

    def test_a_loss_of_lock_between_kept_epochs_is_reported_at_the_next(self):
        observations = recording()
        satellite = observations.epochs[7].satellites[0]
        satellite.values["L1C"] = satellite.values["L1C"].with_lock(1)
        changed, _ = faults.inject(observations, ["thin=5"], 1)
        flags = {time: reading.lock for time, reading in series(changed, "G01", "L1C").items()}
        self.assertEqual((flags[5.0], flags[10.0], flags[15.0]), (" ", "1", " "))

    def test_cn0_is_shifted_and_scaled_about_forty(self):
        changed, _ = self.inject("cn0-shift=4", "cn0-scale=0.5")
        # Of 41 dB-Hz: 40 + 0.5·(41 + 4 − 40).
        self.assertEqual(series(changed, "G02", "S1C")[0.0].number, 42.5)

    def test_a_bad_start_is_constant_and_ends(self):
        names = [f"G{number:02d}" for number in range(1, 33)]
        changed, spans = self.inject("bad-start=20", names=names)
        self.assertEqual(spans, [(START, START + 20.0)])
        constants = []
        for name in names:
            by_time = {t: r.number - 2e7 - 100.0 * t for t, r in series(changed, name, "C1C").items()}
            constants.append(by_time[0.0])
            self.assertAlmostEqual(by_time[0.0], by_time[19.0], 6)
            self.assertEqual(by_time[20.0], 0.0)
        late_ones = [constant for constant in constants if constant]
        # 60 % of 32, binomial deviation 2.8; mean of 60 m, deviation 60/√19.
        self.assertTrue(11 <= len(late_ones) <= 27, len(late_ones))
        self.assertTrue(20.0 < sum(late_ones) / len(late_ones) < 105.0)

    def test_phases_stay_where_pseudoranges_are_late(self):
        changed, _ = self.inject("bad-start=20", "jump=50:30", "wild=0.1")
        clean, disturbed = (series(one, "G03", "L1C") for one in (recording(), changed))
        self.assertEqual(clean, disturbed)

    def test_a_blackout_leaves_the_weakest_three(self):
        changed, spans = self.inject("blackout=120:20")
        names = [[one.name for one in epoch.satellites] for epoch in changed.epochs]
        self.assertEqual(names[119], ["G01", "G02", "G03", "G04", "E05", "E06"])
        self.assertEqual((names[120], names[139]), (["G01", "G02", "G03"],) * 2)
        self.assertEqual(len(names[140]), 6)
        self.assertEqual(spans, [(START + 120.0, START + 140.0)])

    def test_a_jump_makes_half_of_the_satellites_late(self):
        changed, _ = self.inject("jump=120:50")
        at = [late(changed, name, "C1C").get(130.0) for name in ("G01", "G02", "G03", "G04")]
        at += [late(changed, name, "C1X").get(130.0) for name in ("E05", "E06")]
        self.assertEqual(sorted(at), [0.0, 0.0, 0.0, 50.0, 50.0, 50.0])

    def test_reflections_last_and_weaken(self):
        names = [f"G{number:02d}" for number in range(1, 33)]
        changed, _ = self.inject("reflect=0.3", names=names, epochs=600)
        reflected = 0
        for order, name in enumerate(names):
            ranges, strengths = (series(changed, name, code) for code in ("C1C", "S1C"))
            for time, reading in ranges.items():
                excess = reading.number - 2e7 - 100.0 * time
                reflected += 0.0 != excess
                # A ranging noise of 1 m beside what is at least 1 m.
                self.assertTrue(-5.0 < excess)
                self.assertTrue(strengths[time].number <= 40.0 + order)
        # 30 % of the time; some 8 reflections a satellite of 25 s each.
        self.assertTrue(0.2 < reflected / 32 / 600 < 0.4, reflected)

    def test_slips_stay_in_the_phase(self):
        changed, _ = self.inject("slips=120")
        clean = series(recording(), "G01", "L1C")
        slipped = {t: round(r.number - clean[t].number, 6) for t, r in series(changed, "G01", "L1C").items()}
        steps = [b - a for a, b in zip(list(slipped.values()), list(slipped.values())[1:]) if a != b]
        self.assertTrue(1 <= len(steps) <= 20, steps)
        self.assertTrue(all(step == round(step) and 1 <= abs(step) <= 50 for step in steps), steps)

    def test_half_cycles_are_flagged_five_seconds_and_then_resolved(self):
        changed, _ = self.inject("half=60", epochs=600)
        clean = series(recording(epochs=600), "G02", "L1C")
        found = series(changed, "G02", "L1C")
        begins = [t for t in found if found[t].lock == "3"]
        self.assertTrue(begins)
        for begin in begins[:-1]:
            flags = [found[begin + second].lock for second in range(7)]
            self.assertEqual(flags[:6], ["3", "2", "2", "2", "2", "1"])
            offsets = {round(found[begin + s].number - clean[begin + s].number, 6) for s in range(5)}
            self.assertIn(offsets, ({0.0}, {0.5}))

    def test_a_clock_step_is_seen_by_ranges_not_phases(self):
        changed, _ = self.inject("steps")
        ranges, phases = series(changed, "G01", "C1C"), series(changed, "G01", "L1C")
        clean = series(recording(), "G01", "L1C")
        self.assertEqual(ranges[96.0].number, 2e7 + 9600.0)
        # One millisecond later the range was 0.1 m shorter, and the clock shows c·1 ms more.
        self.assertAlmostEqual(ranges[97.0].number, 2e7 + 9700.0 + 1e-3 * SPEED_OF_LIGHT - 0.1, 6)
        self.assertAlmostEqual(ranges[194.0].number, 2e7 + 19400.0 + 2e-3 * SPEED_OF_LIGHT - 0.2, 6)
        wavelength_m = SPEED_OF_LIGHT / 1575.42e6
        self.assertAlmostEqual((phases[97.0].number - clean[97.0].number) * wavelength_m, -0.1, 6)

    def test_a_step_without_doppler_takes_the_rate_of_ranges(self):
        with_doppler, _ = self.inject("steps")
        without = recording()
        for epoch in without.epochs:
            for satellite in epoch.satellites:
                for code in satellite.of_kind("D"):
                    del satellite.values[code]
        by_ranges, _ = faults.inject(without, ["steps"], 1)
        one, other = (series(changed, "G01", "C1C")[150.0].number for changed in (with_doppler, by_ranges))
        self.assertAlmostEqual(one, other, 4)

    def test_gaps_are_pauses_and_named(self):
        changed, spans = self.inject("gaps=2", epochs=600)
        times = {epoch.time for epoch in changed.epochs}
        for begin, end in spans:
            self.assertTrue(3.0 <= end - begin <= 40.0)
            self.assertFalse(any(begin <= time < end for time in times))

    def test_kinds_of_observations_are_left_out(self):
        changed, _ = self.inject("no-cn0", "no-doppler", "no-phase")
        self.assertEqual(list(changed.epochs[0].satellites[0].values), ["C1C"])
        observations = recording()
        observations.epochs[0].satellites[0].values["L1C"] = Value(5.0, "3", "7")
        changed, _ = faults.inject(observations, ["no-lli"], 1)
        self.assertEqual(changed.epochs[0].satellites[0].values["L1C"], Value(5.0, " ", "7"))

    def test_shuffled_epochs_hold_the_same_and_some_twice(self):
        changed, _ = self.inject("shuffle")
        self.assertEqual(len(changed.epochs), 204)
        self.assertEqual(sorted(one.name for one in changed.epochs[0].satellites), recording().satellites())


if __name__ == "__main__":
    unittest.main()
