"""What a change of the input must do to the result: every relation for every door, written once.

The rows are in ``subjects.py``, the relations in ``relations.py``.
"""

from __future__ import annotations

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from relations import LOCAL, RELATIONS, Draw
from subjects import SUBJECTS

PAIRS = [
    pytest.param(name, relation, id=f"{name}-{relation}")
    for name, subject in SUBJECTS.items()
    for relation in RELATIONS[subject.sort]
    if relation not in subject.without and (relation not in LOCAL or subject.reach is not None)
]

DRAWS = st.builds(
    Draw,
    seed=st.integers(1, 99),
    power=st.sampled_from([-200, -75, -3, 5, 68, 300]),
    shift=st.sampled_from([-3.0, 1e4, -1e6, 1e8]),
    far=st.sampled_from([-5.0, 1e3, -1e6, 1e12, 1e30]),
)


@pytest.mark.parametrize(("name", "relation"), PAIRS)
# a failing draw is printed as it is: shrinking and explaining it takes minutes
@settings(max_examples=2, deadline=None, derandomize=True, database=None, phases=[Phase.generate])
@given(draw=DRAWS)
def test_relation(name, relation, draw):
    subject = SUBJECTS[name]
    RELATIONS[subject.sort][relation](subject, "numpy", draw)


@pytest.mark.parametrize("relation", ["scaled", "shifted", "spoiled"])
@pytest.mark.parametrize("name", ["denoise_nl_means", "denoise_bilateral", "denoise_tv"])
def test_relation_on_a_device(name, relation, device):
    subject = SUBJECTS[name]
    RELATIONS[subject.sort][relation](subject, device, Draw())
