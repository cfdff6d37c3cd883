"""The measures of a run, from answers made by hand."""

import unittest

from judging import report
from judging.positions import Answer, Truth
from judging.runs import Job, Method, Run, _Disturbance, _Judge, _judge_kept, _judge_recovery

PLACE = (6378137.0, 0.0, 0.0)


def answer(time, east_m, status="FIXED", **rest):
    """An answer at a distance east of a position on the equator."""
    return Answer(time, status, (PLACE[0], east_m, 0.0), covariance=(1.0, 1.0, 0.0), **rest)


def new_run(recording="one", variant=""):
    return Run("build", recording, "city", True, "faults", "thin=5", variant, "rtk-fgo")


def judged(answers, wrong_m=0.5, truth=None):
    run = new_run()
    judge = _Judge(run, truth or Truth.fixed(PLACE), wrong_m, 0.0)
    judge.count(answers)
    return run, judge


class Recovering(unittest.TestCase):
    def test_the_truth_misses_an_undisturbed_run_that_is_wrong(self):
        # Undisturbed: 4 m off the truth up to 40 s, 2 m after. Disturbed up to 10 s, 3.5 m off after.
        before = [answer(float(t), 4.0 if t < 40 else 2.0, "FGO") for t in range(60)]
        after = [answer(float(t), 90.0 if t < 10 else 3.5, "FGO") for t in range(60)]
        job = Job(None, "faults", "jump", (), (), faults=("jump",))
        run, disturbance = new_run(), _Disturbance([(0.0, 10.0)], None)
        _judge_recovery(run, job, Method("fgo"), after, before, disturbance, Truth.fixed(PLACE))
        self.assertEqual((run.recovery_s, run.truth_recovery_s), (0.0, 30.0))


class Counting(unittest.TestCase):
    def test_epochs_answers_and_errors(self):
        run, _ = judged([answer(0.0, 3.0, "FLOAT"), Answer(1.0, "NONE"), answer(2.0, -1.0, "FLOAT")])
        self.assertEqual((run.epochs, run.answered, list(run.errors)), (3, 2, [3.0, 1.0]))

    def test_epochs_without_truth_do_not_count(self):
        truth = Truth([0.0, 1.0], [PLACE, PLACE])
        run, _ = judged([answer(0.0, 0.0), answer(5.0, 0.0)], truth=truth)
        self.assertEqual((run.epochs, run.fixed), (1, 1))

    def test_wrong_fixes_and_their_stretches(self):
        run, _ = judged([answer(t, 0.6 if t in (1, 2, 8) else 0.4) for t in range(10)])
        self.assertEqual((run.fixed, run.wrong, run.wrong_stretches), (10, 3, 2))

    def test_the_ellipse_by_status(self):
        # 95 % of a unit circle lie within √5.991 = 2.448.
        run, _ = judged([answer(0.0, 2.4, "FLOAT"), answer(1.0, 2.5, "FLOAT"), answer(2.0, 0.0)])
        n, inside, squares, *_ = run.stated["FLOAT"][0]
        self.assertEqual((n, inside), (2, 1))
        self.assertAlmostEqual(squares, 0.5 * (2.4**2 + 2.5**2))
        self.assertEqual(run.stated["FIXED"][0][:2], [1, 1])

    def test_protection_levels(self):
        run, _ = judged([answer(t, 2.0, "FGO", protection=(level, 9.0)) for t, level in enumerate((1.9, 2.1))])
        self.assertEqual(run.stated["FGO"][0][3:], [2, 1])

    def test_reliability_by_class(self):
        run, _ = judged([answer(0.0, 0.6, probability=0.995), answer(40.0, 0.0, probability=0.999)])
        self.assertEqual([key for key in run.reliability], [0.99, 0.999])
        fixes, wrong, risk = run.reliability[0.99][0]
        self.assertEqual((fixes, wrong, round(risk, 9)), (1, 1, 0.005))
        self.assertEqual(run.reliability[0.999][1][:2], [1, 0])

    def test_comparison_over_epochs_that_both_answer(self):
        run, judge = judged([])
        own = [answer(t, 1.0) for t in (0.0, 1.0, 31.0)]
        its = [answer(0.0, 4.0), Answer(1.0, "NONE"), answer(31.0, 2.0)]
        judge.compare(own, its, run.single, run.against_single)
        self.assertEqual((list(run.single[0]), list(run.single[1])), ([1.0, 1.0], [4.0, 2.0]))
        self.assertEqual(run.against_single, {0: [1.0, 4.0], 1: [1.0, 2.0]})

    def test_fixes_kept_outside_the_fault_and_a_minute(self):
        run, judge = judged([])
        before = [answer(float(t), 0.6 if t == 5 else 0.0) for t in range(200)]
        now = [answer(one.time, 0.0, "FLOAT" if one.time < 110.0 else "FIXED") for one in before]
        _judge_kept(run, judge, now, before, _Disturbance([(20.0, 40.0)], None))
        # Right fixes at 0 to 19 without 5, and from 100 on; fixed again from 110 on.
        self.assertEqual((run.fixes_before, run.fixes_kept), (119, 90))


class Reporting(unittest.TestCase):
    def run_of(self, variant, errors, its):
        run = new_run(variant=variant)
        for index, (own, other) in enumerate(zip(errors, its)):
            run.errors.append(own)
            run.single[0].append(own)
            run.single[1].append(other)
            run.against_single[index] = [own, other]
        return run

    def test_groups_pool_their_runs(self):
        runs = [self.run_of("a", [1.0] * 40, [2.0] * 40), self.run_of("b", [3.0] * 40, [2.0] * 40)]
        (group,) = report.groups(runs)
        summary = group.summary()
        self.assertEqual((summary["runs"], summary["error"]["mean"]), (2, 2.0))
        self.assertEqual(summary["single"]["mean_ratio"], 1.0)
        self.assertEqual(summary["single_worst"], {"variant": "b", "mean_ratio": 1.5, "p95_ratio": 1.5})
        # Both variants share their episodes: each has (1 + 3)/(2 + 2).
        self.assertEqual(summary["single_interval"], (1.0, 1.0))

    def test_classes_of_probability_pool_episodes(self):
        runs = [new_run(variant="a"), new_run(variant="b")]
        runs[0].reliability = {0.99: {7: [10, 1, 0.05]}}
        runs[1].reliability = {0.99: {7: [10, 0, 0.05], 8: [20, 0, 0.1]}}
        (row,) = report.reliability(runs)
        self.assertEqual((row["fixes"], row["episodes"], row["wrong"]), (40, 2, 1 / 40))
        self.assertAlmostEqual(row["stated"], 0.2 / 40)

    def test_ellipses_draw_recordings_where_there_are_five(self):
        def run_at(name, inside):
            run = new_run(recording=name)
            run.stated = {"FGO": {0: [10, inside, 10.0, 0, 0], 1: [10, inside, 10.0, 0, 0]}}
            return run

        (few,) = report.ellipses([run_at(str(i), 9) for i in range(4)])
        (many,) = report.ellipses([run_at(str(i), 9) for i in range(5)] + [run_at("spirent-static", 0)])
        self.assertEqual((few["clusters"], many["clusters"]), (8, 5))
        self.assertEqual((many["inside"], many["normalised"], many["exceeded"]), (0.9, 1.0, None))


if __name__ == "__main__":
    unittest.main()
