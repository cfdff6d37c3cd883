"""Percentiles, bootstrap and recovery against values worked by hand."""

import math
import unittest

from judging import measures
from judging.measures import Sample


class Measures(unittest.TestCase):
    def test_percentiles_lie_between_order_statistics(self):
        # Index 0.95·4 = 3.8 of 1, 2, 3, 4, 10: 4 + 0.8·6.
        self.assertAlmostEqual(measures.percentile([10, 3, 1, 4, 2], 95.0), 8.8)
        self.assertEqual(measures.percentile([7.0], 95.0), 7.0)
        self.assertIsNone(measures.percentile([], 50.0))

    def test_error_summary(self):
        found = measures.error_summary([1.0, 2.0, 3.0, 6.0])
        self.assertEqual((found["n"], found["mean"], found["p50"], found["max"]), (4, 3.0, 2.5, 6.0))

    def test_an_interval_of_equal_clusters_has_no_width(self):
        self.assertEqual(measures.ratio_interval([(1.0, 4.0)] * 10, 1), (0.25, 0.25))

    def test_the_interval_of_two_clusters_is_that_of_their_four_draws(self):
        # Draws: (1, 1) twice 1/4, both orders of (0, 1) 1/2, (0, 0) 1/4: the ratio is 0, 1/2 or 1.
        self.assertEqual(measures.ratio_interval([(1.0, 1.0), (0.0, 1.0)], 1), (0.0, 1.0))

    def test_the_interval_holds_the_mean_of_many_clusters_as_often_as_it_says(self):
        # Binomial, n = 400, p = 1/2: deviation 2.5 %; ±1.96 of it is 45.1 to 54.9 %.
        clusters = [(index % 2, 1) for index in range(400)]
        low, high = measures.ratio_interval(clusters, 7)
        self.assertAlmostEqual(low, 0.451, delta=0.01)
        self.assertAlmostEqual(high, 0.549, delta=0.01)

    def test_no_interval_of_one_cluster_or_of_nothing_below(self):
        self.assertIsNone(measures.ratio_interval([(1.0, 2.0), (0, 0)], 1))
        self.assertIsNone(measures.ratio_interval([(1.0, 0.0), (1.0, 0.0)], 1))

    def test_episodes_are_thirty_seconds(self):
        self.assertEqual([measures.episode(time) for time in (0.0, 29.9, 30.0, 60.0)], [0, 0, 1, 2])

    def test_stretches_end_with_a_pause(self):
        self.assertEqual(measures.runs_of([5, 1, 2, 9], 2.0), [(1, 2), (5, 5), (9, 9)])

    def test_the_normalised_square_of_a_correlated_error(self):
        # Σ = [2 1; 1 2], Σ⁻¹ = [2 −1; −1 2]/3: of (1, 0) 2/3, of (1, 1) 2/3, of (1, −1) 2.
        for error, square in (((1, 0), 2 / 3), ((1, 1), 2 / 3), ((1, -1), 2.0)):
            self.assertAlmostEqual(measures.normalised_square(*error, (2.0, 2.0, 1.0), 0.0), square)
        # The truth's own variance of 1 per axis: [3 1; 1 3], Σ⁻¹ = [3 −1; −1 3]/8.
        self.assertAlmostEqual(measures.normalised_square(1, 0, (2.0, 2.0, 1.0), 1.0), 3 / 8)
        self.assertIsNone(measures.normalised_square(1, 0, (1.0, 1.0, 1.0), 0.0))

    def test_the_ellipse_is_that_of_two_degrees_of_freedom(self):
        self.assertAlmostEqual(measures.ELLIPSE_95, 5.991, 3)


class Recovery(unittest.TestCase):
    def samples(self, text, counts=""):
        """From second 10: `x` away, `o` back, `?` unknown; `n` in `counts` is too few satellites."""
        states = {"x": False, "o": True, "?": None}
        counts = counts.ljust(len(text), "y")
        return [Sample(10.0 + i, counts[i] == "y", states[s]) for i, s in enumerate(text)]

    def test_seconds_until_back(self):
        self.assertEqual(measures.recovery_s(self.samples("xxxoooooo"), 10.0), 3.0)
        self.assertEqual(measures.recovery_s(self.samples("ooooooo"), 10.0), 0.0)

    def test_what_does_not_last_five_seconds_does_not_count(self):
        self.assertEqual(measures.recovery_s(self.samples("xooooxoooooo"), 10.0), 6.0)

    def test_only_time_with_satellites_counts(self):
        self.assertEqual(measures.recovery_s(self.samples("xxxxoooooo", "yynny"), 10.0), 2.0)

    def test_unknown_epochs_neither_help_nor_hinder(self):
        self.assertEqual(measures.recovery_s(self.samples("x?o?o?ooo"), 10.0), 2.0)
        self.assertIsNone(measures.recovery_s(self.samples("???"), 10.0))

    def test_never_back(self):
        self.assertEqual(measures.recovery_s(self.samples(31 * "x"), 10.0), math.inf)

    def test_a_recording_that_ends_too_early_does_not_say(self):
        self.assertIsNone(measures.recovery_s(self.samples(30 * "x"), 10.0))

    def test_a_pause_does_not_count(self):
        # Epochs at 10 to 13 s and 23 to 33 s; back from 24 s on: 3 s before the pause, 1 s after it.
        before, after = self.samples("xxxx"), self.samples("xoooooooooo")
        moved = [Sample(13.0 + one.time, one.counts, one.is_back) for one in after]
        self.assertEqual(measures.recovery_s(before + moved, 10.0), 4.0)

    def test_what_was_before_the_end_is_not_looked_at(self):
        self.assertEqual(measures.recovery_s(self.samples("xxxxxoooooo"), 13.5), 1.5)


if __name__ == "__main__":
    unittest.main()
