"""The array machine gives what casadi gives, to the last bit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hitchopt.model import array_machine as machines
from hitchopt.model.array_machine import CHUNK, array_machine
from hitchopt.model.attitude import attitude_function
from hitchopt.model.loaded_clasp import loaded_clasp_function
from hitchopt.model.robot import robot_function
from hitchopt.model.slipping import slipping_clasp_function

FUNCTIONS = {
    "equal tensions": robot_function(True),
    "any tensions": robot_function(False),
    "heavy, rolled": loaded_clasp_function(True, True),
    "loads alone": loaded_clasp_function(False, False),
    "slipping": slipping_clasp_function(),
}


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
@pytest.mark.parametrize("columns", [1, 300, CHUNK + 7])
def test_columns_are_those_of_casadi(
    function: ca.Function, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Roots of negative numbers are nan in both, and raise nothing."""
    rng = np.random.default_rng(columns)
    inputs = [
        rng.normal(size=(columns, *function.sparsity_in(i).shape)) for i in range(function.n_in())
    ]
    machine = array_machine(function)
    assert machine is not None
    monkeypatch.setattr(machines, "MANY", columns + 1)
    for found, wanted in zip(
        machine.evaluate(inputs), machines.mapped(function, inputs), strict=True
    ):
        assert found.shape == wanted.shape
        np.testing.assert_array_equal(found, wanted)


def test_every_operation_is_numpys() -> None:
    a, b = ca.SX.sym("a", 2, 3), ca.SX.sym("b")
    terms = [a + b, a - b, a * b, a / b, a * a, ca.sqrt(a), -a, ca.sin(a), ca.cos(b), 2.0 * a]
    function = ca.Function("all", [a, b], [ca.vertcat(*terms[:-2]), terms[-2], terms[-1] + 0.3])
    machine = array_machine(function)
    assert machine is not None
    x, y = np.random.default_rng(0).uniform(0.5, 2.0, (2, 40, 2, 3))
    found = machine.evaluate([x, y[:, :1, :1]])
    for c in range(40):
        for one, wanted in zip(found, function(x[c], y[c, 0, 0]), strict=True):
            np.testing.assert_allclose(one[c], np.array(wanted), rtol=1e-15)


def test_what_numpy_lacks_is_left_to_casadi() -> None:
    x = ca.SX.sym("x", 2, 2)
    assert array_machine(ca.Function("sparse", [x], [ca.diag(x[:, 0])])) is None
    assert array_machine(ca.Function("choice", [x], [ca.if_else(x > 0.0, x, 1.0)])) is None
    assert array_machine(attitude_function()) is None
