"""The benchmark of the solvers: problem sets, peers, timing, judged answers, report."""
