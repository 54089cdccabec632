"""Plan the aborts of a plan in another process while it flies.

The process plans in the order of the plan's times. Where the plan's clock has overtaken it, it goes
on ahead of the clock, and plans what it has left out at the end.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Protocol

from hitchopt.live.abort import Abort, Aborts, AbortTable
from hitchopt.motion.flight import Flight

LEAD = 6.0  # lead of what is planned next over a clock that has overtaken the planning [s]
NICENESS = 5  # setpoints come first


class Clock(Protocol):
    """A plan time that processes share [s]."""

    value: float


def saved_entries(table: AbortTable) -> dict[float, Abort]:
    """Return the entries of a table by the times of their commands [s]."""
    return {entry.asked: entry for entry in table.entries}


def replanned(table: AbortTable) -> AbortTable:
    """Return a saved table with its entries to be certified again, each at its own time."""
    times = sorted({*table.pending, *saved_entries(table)})
    return AbortTable(table.how, (), table.end, table.refused, tuple(times), table.every)


def next_time(table: AbortTable, clock: float) -> float:
    """Return the time [s] to plan next: the first, or one ahead of a clock that has passed it."""
    if table.pending[0] >= clock:
        return table.pending[0]
    later = [time for time in table.pending if time >= clock]
    return min(later, key=lambda time: abs(time - clock - LEAD), default=table.pending[0])


def outcomes(
    flight: Flight, saved: Mapping[str, AbortTable], clock: Clock
) -> Iterator[tuple[str, float, Abort | None]]:
    """Yield reactions, times of commands [s], and the aborts planned for them, if there are any.

    ``saved`` tables have entries that are certified again instead of planned.
    """
    aborts = Aborts(flight)
    known = {how: saved_entries(table) for how, table in saved.items()}
    tables = {how: replanned(table) for how, table in saved.items()}
    while any(table.pending for table in tables.values()):
        now = clock.value
        pending = [table for table in tables.values() if table.pending]
        table = min(pending, key=lambda each: (next_time(each, now) < now, each.planned))
        how = table.how
        time = next_time(table, now)
        entry = aborts.find(time, how, known[how].get(time))
        tables[how] = tables[how].with_outcome(time, entry)
        yield how, time, entry


def _send_outcomes(
    connection: Connection, flight: Flight, saved: Mapping[str, AbortTable], clock: Clock
) -> None:
    """Send all outcomes to the process that flies, whose terminal does not end this one."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    try:
        for outcome in outcomes(flight, saved, clock):
            connection.send(outcome)
    except BrokenPipeError:
        return  # the flight has ended
    finally:
        connection.close()


class AbortsAhead:
    """Tables of aborts that grow while their plan flies.

    Parameters
    ----------
    flight: the plan.
    saved: tables by their reactions, with entries to be certified again and times to be planned.
    """

    def __init__(self, flight: Flight, saved: Mapping[str, AbortTable]) -> None:
        self._context = multiprocessing.get_context("spawn")  # a fork would copy locks of threads
        self._flight = flight
        self._saved = dict(saved)
        self._receiver, self._sender = self._context.Pipe(duplex=False)
        self.tables = {how: replanned(table) for how, table in saved.items()}
        self.clock: Clock = self._context.Value("d", 0.0)

    @contextmanager
    def planning(self) -> Iterator[None]:
        """Plan in another process within the context, which ends it."""
        parts = self._sender, self._flight, self._saved, self.clock
        process = self._context.Process(target=_send_outcomes, args=parts, daemon=True)
        process.start()
        self._sender.close()  # so that the end of the process ends what is received
        try:
            yield
        finally:
            process.kill()
            process.join()

    @property
    def planned(self) -> float:
        """Share of the plan's times that are planned in all tables, 0 to 1."""
        return min(table.planned for table in self.tables.values())

    @property
    def to_save(self) -> dict[str, AbortTable]:
        """The tables, with saved entries that are not certified again yet."""
        tables = dict(self.tables)
        for how, table in self.tables.items():
            known = saved_entries(self._saved[how])
            for time in known.keys() & {*table.pending}:
                tables[how] = tables[how].with_outcome(time, known[time])
        return tables

    def covers(self, seconds: float) -> bool:
        """Return whether the aborts of the plan's first seconds are planned, and one of each."""
        return all(
            not table.pending or (table.entries and table.pending[0] > seconds)
            for table in self.tables.values()
        )

    def receive(self) -> str:
        """Wait for an outcome; return the reaction whose table it extends, empty at the end."""
        try:
            how, time, entry = self._receiver.recv()
        except (EOFError, OSError):
            return ""
        self.tables[how] = self.tables[how].with_outcome(time, entry)
        return str(how)
