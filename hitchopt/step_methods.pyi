"""Methods of ``step_methods.py``, one for every kind of step, for type checkers and completion."""

from typing import Self

from numpy.typing import ArrayLike

from hitchopt.geometry import Outline
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.single_step import Legs
from hitchopt.steps import Step
from hitchopt.steps.form import Assign
from hitchopt.steps.grasp import By

class StepMethods:
    def then(self, step: Step) -> Self: ...
    def morph(
        self,
        polygon: Outline | ArrayLike,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
        optimize: bool = False,
        tension: tuple[float, float] | None = None,
    ) -> Self: ...
    def hold(self, seconds: float) -> Self: ...
    def move_vertex(
        self,
        vertex: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
    ) -> Self: ...
    def move_edge(
        self,
        edge: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
    ) -> Self: ...
    def adjust(self, legs: Legs, duration: float | None = None, blend: bool = False) -> Self: ...
    def follow_vertex(self, vertex: int, path: ArrayLike, legs: Legs | None = None) -> Self: ...
    def transport(self, to: ArrayLike, yaw: float = 0.0, duration: float | None = None) -> Self: ...
    def form(
        self,
        polygon: Outline | ArrayLike,
        altitude: float = 1.0,
        legs: Legs | None = None,
        assign: Assign = "auto",
        swap: SwapSettings = ...,
        duration: float | None = None,
    ) -> Self: ...
    def release(self, duration: float | None = None) -> Self: ...
    def land(self, duration: float | None = None) -> Self: ...
    def enclose(self, object: str, duration: float | None = None) -> Self: ...
    def grasp(
        self,
        object: str,
        by: By = "rest",
        tension: float | None = None,
        duration: float | None = None,
    ) -> Self: ...
    def lift(self, by: float, duration: float | None = None) -> Self: ...
    def carry(
        self, object: str, to: ArrayLike, yaw: float = 0.0, duration: float | None = None
    ) -> Self: ...
    def set_down(self, object: str, duration: float | None = None) -> Self: ...
    def loosen(self, object: str, duration: float | None = None) -> Self: ...
    def leave(self, object: str, duration: float | None = None) -> Self: ...
    def transport_object(
        self,
        object: str,
        to: ArrayLike,
        by: By | None = None,
        tension: float | None = None,
        yaw: float = 0.0,
        lift: float = 0.3,
    ) -> Self: ...
