"""Casadi functions over many columns at once, instruction by instruction, on numpy's arrays.

A map of casadi evaluates one column after the other. Here every instruction is one call of numpy
for all columns, three to four times as fast where there are hundreds of them; results are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OPERATIONS: dict[int, np.ufunc] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_SQ: np.square,
    ca.OP_SQRT: np.sqrt,
    ca.OP_NEG: np.negative,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
}
"""Operations of casadi that are one of numpy's."""

CHUNK = 6144
"""Number of columns at a time: fewer spend more on calls than on numbers, more leave the cache."""

MANY = 64
"""Number of columns from which on ``array_machine`` is faster than casadi."""

BATCH = MANY
"""Number of columns that a call of casadi evaluates, at most."""


@dataclass(frozen=True, eq=False)
class ArrayMachine:
    """A function as operations on the rows of an array; each row holds a number of all columns.

    Rows are in this order: intermediate values, inputs, constants, outputs.

    Attributes
    ----------
    steps: operation, one or two rows that it reads, and the row that it writes.
    working: number of rows of intermediate values.
    constants: their values.
    shapes: (rows, width) of the outputs.
    """

    steps: tuple[tuple[np.ufunc, tuple[int, ...], int], ...]
    working: int
    constants: tuple[float, ...]
    shapes: tuple[tuple[int, int], ...]

    def evaluate(self, inputs: list[Array]) -> list[Array]:
        """Return the outputs (columns, rows, width) for inputs of that layout."""
        count = len(inputs[0])
        results = [np.empty((rows * width, count)) for rows, width in self.shapes]
        with np.errstate(all="ignore"):  # a root of a negative number is nan, as casadi's
            for first in range(0, count, CHUNK):
                span = slice(first, min(first + CHUNK, count))
                self._run(
                    [array[span].transpose(2, 1, 0) for array in inputs],
                    [result[:, span] for result in results],
                )
        return [
            result.reshape(width, rows, count).transpose(2, 1, 0)
            for result, (rows, width) in zip(results, self.shapes, strict=True)
        ]

    def _run(self, inputs: list[Array], results: list[Array]) -> None:
        """Write outputs (numbers, columns) for inputs (width, rows, columns)."""
        count = inputs[0].shape[-1]
        constants = np.repeat(np.array(self.constants)[:, None], count, axis=1)
        read = [np.ascontiguousarray(array).reshape(-1, count) for array in inputs]
        parts = [np.empty((self.working, count)), *read, constants, *results]
        row = [each for part in parts for each in part]
        for operation, numbers, written in self.steps:
            if len(numbers) == 1:
                operation(row[numbers[0]], row[written])
            else:
                operation(row[numbers[0]], row[numbers[1]], row[written])


@lru_cache
def array_machine(function: ca.Function) -> ArrayMachine | None:
    """Return the machine of a function of scalar instructions.

    None where it has an operation that numpy lacks, or arguments with structural zeros.
    """
    arguments = [function.sparsity_in(i) for i in range(function.n_in())]
    values = [function.sparsity_out(i) for i in range(function.n_out())]
    if not all(pattern.is_dense() for pattern in arguments + values):
        return None
    ids = [function.instruction_id(k) for k in range(function.n_instructions())]
    constants = [function.instruction_constant(k) for k, i in enumerate(ids) if i == ca.OP_CONST]
    working = function.sz_w()
    sizes = [working, *(p.nnz() for p in arguments), len(constants), *(p.nnz() for p in values)]
    starts = list(accumulate(sizes, initial=0))
    found = list(range(working))  # row at which the value of a place of casadi's memory is
    steps, known = list[tuple[np.ufunc, tuple[int, ...], int]](), starts[1 + len(arguments)]
    for k, kind in enumerate(ids):
        read, written = function.instruction_input(k), function.instruction_output(k)
        if kind == ca.OP_INPUT:
            found[written[0]] = starts[1 + read[0]] + read[1]
            continue
        if kind == ca.OP_CONST:
            found[written[0]], known = known, known + 1
            continue
        rows = tuple(found[i] for i in read)
        if kind == ca.OP_OUTPUT:
            place = starts[2 + len(arguments) + written[0]] + written[1]
            steps.append((np.positive, rows, place))
        elif kind == ca.OP_TWICE:
            steps.append((np.add, (rows[0], rows[0]), written[0]))
        elif kind in OPERATIONS:
            steps.append((OPERATIONS[kind], rows, written[0]))
        else:
            return None
        if kind != ca.OP_OUTPUT:
            found[written[0]] = written[0]
    return ArrayMachine(tuple(steps), working, tuple(constants), tuple(p.shape for p in values))


def mapped(function: ca.Function, inputs: list[Array]) -> list[Array]:
    """Return the outputs (columns, rows, width) of ``function`` for inputs of that layout.

    Many columns are evaluated by ``array_machine``, few by casadi, in batches of few sizes: it
    takes longer to make a map than to run it. Its buffers read and write numpy's memory, since
    converting arrays to its own matrices takes four times as long as the evaluation.
    """
    columns = len(inputs[0])
    machine = array_machine(function) if columns >= MANY else None
    if machine is not None:
        return machine.evaluate(inputs)
    size = min(BATCH, 1 << (columns - 1).bit_length())
    padded = -(-columns // size) * size
    given = []
    for array in inputs:
        column_major = np.empty((padded, array.shape[2], array.shape[1]))
        column_major[:columns] = array.transpose(0, 2, 1)
        column_major[columns:] = column_major[0]
        given.append(column_major)
    results = [
        np.zeros((padded, function.size2_out(i), function.size1_out(i)))
        for i in range(function.n_out())
    ]
    buffer, evaluate = _map(function, size).buffer()
    for first in range(0, padded, size):
        for i, array in enumerate(given):
            # casadi's stubs ask for a size, which its wrapper takes from the memory itself.
            buffer.set_arg(i, array[first : first + size].reshape(-1).data)  # type: ignore[call-arg]
        for i, array in enumerate(results):
            buffer.set_res(i, array[first : first + size].reshape(-1).data)  # type: ignore[call-arg]
        evaluate()
    return [array[:columns].transpose(0, 2, 1) for array in results]


@lru_cache(maxsize=64)
def _map(function: ca.Function, size: int) -> ca.Function:
    return function.map(size)
