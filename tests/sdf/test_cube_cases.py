"""The 256 cases of a cube: every crossed edge in one patch, and the ambiguous ones of the papers."""

from __future__ import annotations

from itertools import product

import numpy as np

from genmf_mi.sdf import cube_cases

EDGES = [(0, 1), (1, 5), (4, 5), (0, 4), (2, 3), (3, 7), (6, 7), (2, 6), (0, 2), (1, 3), (5, 7), (4, 6)]


class TestCases:
    def test_edges_are_numbered_as_the_files_of_generators_have_them(self):
        assert cube_cases.EDGES == EDGES
        for axis, u, v in product(range(3), (0, 1), (0, 1)):
            low, high = EDGES[cube_cases.edge_at(axis, u, v)]
            assert high - low == 1 << axis and low >> (axis + 1) % 3 & 1 == u and low >> (axis + 2) % 3 & 1 == v

    def test_every_crossed_edge_is_in_one_patch(self):
        patches, _ = cube_cases.tables()
        for row, labels in enumerate(patches):
            crossed = [(row >> a & 1) != (row >> b & 1) for a, b in EDGES]
            np.testing.assert_array_equal(labels >= 0, crossed)
            sizes = np.bincount(labels[labels >= 0])
            assert len(sizes) <= 4 and (sizes >= 3).all()

    def test_the_problem_cases_are_the_two_of_the_paper(self):
        """Two outside corners across a face (12 ways), or two and one more beside (24); one ambiguous face each."""
        _, doubled = cube_cases.tables()
        cases = np.flatnonzero(doubled >= 0)
        assert sorted(bin(case).count("1") for case in cases) == [5] * 24 + [6] * 12
        for case in cases:
            inside = [case >> corner & 1 for corner in range(8)]
            turns = [[inside[c] for c in corners] for corners in cube_cases.faces()]
            ambiguous = [face for face, (a, b, c, d) in enumerate(turns) if a == c != b == d]
            assert ambiguous == [doubled[case]]
            assert cube_cases.patches(case, doubled[case])[1] == -1, "the other pairs cut the patch in two"
