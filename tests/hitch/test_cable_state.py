"""Records of the states of cables: what they say, and their words in files and in ``verify``."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from hitchopt.motion.cable_state import STATES, CableState
from hitchopt.motion.motion import Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.verify import plan as second
from hitchopt.verify.reading import read
from tests.helpers.plans import planned

GROUND, FREE, CLASPING = "on the ground", "hanging free", "clasping"
LOOSE, TIGHTENED, HITCHED = "loose after a loss", "being tightened", "hitched"
MEANINGS = {
    "has_cables": {GROUND, FREE, CLASPING, LOOSE, TIGHTENED, HITCHED},
    "slack": {GROUND, FREE, CLASPING, LOOSE, TIGHTENED},
    "hangs": {FREE, CLASPING, TIGHTENED},
    "on_ground": {GROUND},
    "linked": {CLASPING, LOOSE, TIGHTENED, HITCHED},
    "clasped": {CLASPING, LOOSE, TIGHTENED},
    "clasping": {CLASPING},
    "tied": {LOOSE, TIGHTENED, HITCHED},
    "loose": {LOOSE},
    "pulls": {TIGHTENED, HITCHED},
    "tightening": {TIGHTENED},
    "hitched": {HITCHED},
}


@pytest.mark.parametrize("name", MEANINGS)
def test_states_are_told_apart(name: str) -> None:
    assert {str(state) for state in STATES if getattr(state, name)} == MEANINGS[name]


@pytest.mark.parametrize("state", STATES, ids=str)
def test_states_are_read_by_their_words(state: CableState) -> None:
    assert CableState.of(str(state)) is state
    assert pickle.loads(pickle.dumps(state)) == state
    is_default = state == CableState.HITCHED
    assert (f"state='{state}'" in repr(Phase("hold", 0, 0.0, 1.0, state=state))) is not is_default


@pytest.mark.parametrize("word", ["standing", "", 3, None, ["hitched"]])
def test_unknown_words_are_refused(word: object) -> None:
    with pytest.raises(ValueError, match="is not a valid CableState"):
        CableState.of(word)


def test_both_opinions_mean_the_same_by_states(tmp_path: Path) -> None:
    assert {state.word for state in STATES} == second.STATES
    for state in STATES:
        number = second.CROSSINGS.get(state.word)
        assert number == (None if state.clasping or not state.has_cables else state.tied)
        assert (state.word in second.UNLINKED) == (state.has_cables and not state.linked)
    motion = planned("form_triangle").motion
    assert {state.word for state in motion.cable_states} == MEANINGS["has_cables"] - {LOOSE}
    write_plan(tmp_path / "plan.npz", planned("form_triangle").flight)
    ((plan,), _) = read(tmp_path / "plan.npz")
    np.testing.assert_array_equal(plan.formed, motion.formed)
    np.testing.assert_array_equal(plan.pulling, motion.pulling)
    np.testing.assert_array_equal(plan.free, motion.in_states(lambda state: state.slack))
    np.testing.assert_array_equal(plan.clasping, motion.in_states(lambda state: state.clasped))
