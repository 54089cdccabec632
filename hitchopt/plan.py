"""Certified plans: sample, save, export, combine and load them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import NAMES
from hitchopt.checks.separation import CLOSENESS_SPANS, Closeness, closeness
from hitchopt.errors import FileError, InputError, OneLine, Progress, contained, short
from hitchopt.hitch import Hitch
from hitchopt.mission.others import NAME, named_teams
from hitchopt.motion.flight import Flight
from hitchopt.motion.loads import (
    assumption_notes,
    ellipsoid_notes,
    tracking_warnings,
    weightless_notes,
)
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.plan_file import SavedPlan, flight_digest, read_saved_plan
from hitchopt.motion.request import check_request
from hitchopt.motion.retiming import shifted
from hitchopt.motion.stated_rules import StatedRule
from hitchopt.motion.states import States, final_hitch, flight_states_at
from hitchopt.slices import hooks, provided
from hitchopt.storage.archive import PLAN
from hitchopt.storage.files import replace_files
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.support import Feature
from hitchopt.values import check_instance, counted, flag, integer, nonnegative, path, text
from hitchopt.values.fields import suggest_keywords, with_suggestions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from hitchopt.exports.exporting import Export
    from hitchopt.view.live import LiveView

FLOWN_ERROR = 0.02
"""[m] Mean error of positions in swarms of Crazyflies (Preiss et al., Crazyswarm, ICRA 2017)."""


@with_suggestions
@dataclass(frozen=True, eq=False)
class Plan(OneLine):
    """A certified flight of a hitch, of a swarm without cables, or of several teams.

    ``flight`` holds a motion for each team, with its polynomials, team and requirements, and
    external plans; ``certificate`` the checks over all t; ``title`` and ``problem`` the title and
    the text of the problem file, if any.

    Raises InputError if the certificate is that of another flight.
    """

    flight: Flight
    certificate: Certificate
    title: str = ""
    problem: str = ""

    def __post_init__(self) -> None:
        check_instance("flight", self.flight, Flight)
        check_instance("certificate", self.certificate, Certificate)
        if self.certificate.flight_digest != flight_digest(self.flight):
            bound = "that of the same flight"
            remedy = "pass hitchopt.certify(flight)"
            raise InputError("certificate", "of another flight", bound, remedy)

    def _parts(self) -> Iterator[str]:
        limited = self.certificate.limited
        unproven = self.certificate.not_recomputed
        yield from [short(self.title)] if self.title else []
        yield counted(len(self.flight.team.drone_names), "drone")
        yield f"{self.duration:.4g} s, phases: {len(self.phases)}"
        yield f"{sum(check.holds for check in limited)} of {len(limited)} limits hold"
        yield from [f"{len(unproven)} not recomputed"] if unproven else []

    @property
    def motion(self) -> Motion:
        """The motion of the only team.

        Raises UnsupportedError for several teams: each has its motion in ``flight.teams``.
        """
        return self.flight.of_one_team(Feature.MOTION)

    @property
    def stated_rules(self) -> tuple[StatedRule, ...]:
        """Custom rules that were certified, in the form of the plan's file."""
        return self.certificate.stated_rules

    @property
    def duration(self) -> float:
        """Duration of all steps together [s]."""
        return self.flight.duration

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The time spans of the steps, in order."""
        return self.flight.phases

    @property
    def end(self) -> Hitch:
        """The hitch at the end of the plan, from which another plan can start.

        Raises InputError if the plan ends with free cables, UnsupportedError if the tensions have
        changed, or for several teams.
        """
        return final_hitch(self.flight.of_one_team(Feature.END))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: assumptions, and tracking errors below those of drones.

        Cables are assumed to be weightless if the problem states no density. If a plan lacks the
        text of its problem, a density above 0, and an ellipsoid other than the default, are taken
        as stated.
        """
        notes = list[str]()
        with contained("a note"):
            request = parse_yaml(self.problem) if self.problem else None
            notes += weightless_notes(self.flight, request)
            notes += ellipsoid_notes(self.flight, request)
            notes += assumption_notes(self.flight, request)
            notes += tracking_warnings(self.flight)
            notes += self._distance_notes()
            for noted in hooks("notes"):
                notes += noted(self.certificate.checks)
        return tuple(notes)

    def _distance_notes(self) -> Iterator[str]:
        """Yield a note if no tracking errors are stated, and distances leave room for none."""
        for each in self.flight.teams:
            team = each.motion.team
            limits = each.motion.requirements.limits
            if team.tracking is not None or limits.tube.largest > 0.0:
                return
        worst = {check.name: check.worst for check in self.certificate.checks}
        radius = worst.get("tracking_radius")
        if radius is not None and radius < FLOWN_ERROR:
            yield (
                f"tracking_radius is {1e3 * radius:.2g} mm; real drones are "
                f"{100.0 * FLOWN_ERROR:.0f} cm off or more, and may come too close: "
                "set limits.tracking to your drones' error"
            )

    def _repr_html_(self) -> str:
        """Return the summary card for notebooks: picture, phases, certificate and notes."""
        card: str = provided("card")(self)
        return card

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the start, paths and end from above on matplotlib axes; return the axes.

        Without ``axes``, a new pyplot figure is created.
        """
        drawn: Axes = provided("plot")(self, axes)
        return drawn

    def to_dataframe(self, rate: float = 100.0) -> DataFrame:
        """Return the rows of ``setpoints.csv``, with their phases, as a pandas data frame.

        ``rate`` is the sampling rate [Hz]; the end is included. Raises UnsupportedError if
        pandas is not installed.
        """
        from hitchopt.directory import data_frame

        return data_frame(self.flight, rate)

    def at(self, t: ArrayLike) -> States:
        """Return the states of drones and vertices at times t (…) [s]: arrays of leading shape (…).

        Drones and robots are in the order of the problem. The drones rest after the end. Raises
        InputError for a time before the start.
        """
        return flight_states_at(self.flight, t).listed(self.flight.team)

    def abort(self, t: float, how: str = "hold") -> Plan:
        """Return the plan up to time t, followed by a certified abort.

        The common clock of all drones slows to rest as fast as the limits allow. The rest of the
        abort is planned from there.

        Parameters
        ----------
        t: time of the command [s].
        how: ``hold`` stops and stays; ``back`` stops and flies backward to the last phase with free
            hanging cables, or to the start without cables; ``release_and_land`` stops, unties the
            hitch and lands; ``land`` stops and descends vertically, tied or not. A lifted object is
            set down first, as in the plan.

        Raises
        ------
        InputError: a time outside the plan, or an unknown reaction.
        InfeasibleError: no abort was found; lists the limits that bind.
        """
        entry = provided("abort")(self.flight, t, how)
        rules = tuple(replace(rule, worst=None) for rule in self.stated_rules)
        certificate = entry.certificate.stating(rules)
        return Plan(entry.flight, certificate, f"{self.title} ({how} at {t:g} s)".strip())

    def after_loss(self, robot: int | str, t: float, how: str = "hold") -> Plan:
        """Return the plan after the loss of a robot at time t [s].

        It begins with the loss: all fly on, for 0.1 s or to the next prepared stop, and stop with
        the plan's clock; the lost robot's drones, the team ``lost``, have dropped their cable and
        rise. Of the others, the team ``chain``, both neighbours at its clasps move to where the
        chain is in balance, and tensions rise again. Its robots are numbered in the problem's order
        without the lost one.

        Parameters
        ----------
        robot: its number, or ``a.2`` of one of several teams.
        t: time at which it is lost, while a hitch is taut [s].
        how: ``hold`` the chain, or ``land``: untied, or else tied, or else, with ``team.release``,
            as single drones of the team ``lost`` that drop all cables when they stop.

        Raises
        ------
        InputError: an unknown robot, one whose loss leaves two pieces, or a time without a hitch.
        InfeasibleError: a limit that is not kept after the loss.
        """
        found = provided("after_loss")(self.flight, str(robot), t, how)
        title = f"{self.title} (robot {robot} lost at {t:g} s)".strip()
        return Plan(found.flight, found.certificate, title)

    def save(
        self,
        directory: Path | str,
        rate: float = 100.0,
        progress: Progress | None = None,
        *,
        report: bool = False,
        picture: bool = False,
    ) -> Path:
        """Write the plan, setpoints at ``rate`` [Hz] and certificate; return the path.

        With ``report``, ``report.html`` is written as well. Either all files are written or none,
        even if the process is killed; only files with these names are replaced. With ``picture``,
        ``summary.png`` follows; if it fails, a warning is issued.

        Raises
        ------
        CertificateError: the certificate does not hold.
        InputError: the rate is not positive.
        FileError: the directory is not writable.
        """
        from hitchopt.directory import REPORT, save_plan

        folder = path("directory", directory)
        is_drawn = flag("picture", picture)

        def report_share(fraction: float) -> None:
            if progress is not None:
                progress(f"writing tables, {fraction:.0%}")

        content = self.flight, self.certificate, self.title
        pages = {REPORT: lambda file: self._write_report(file, file.parent)}
        pages = pages if flag("report", report) else {}
        save_plan(folder, *content, rate, pages, report_share, self.problem)
        if is_drawn:
            with contained("summary.png"):
                self.draw(folder)
        return folder

    def draw(self, directory: Path | str) -> Path:
        """Draw ``summary.png`` into the directory where the plan is saved; return its path.

        Raises FileError if another plan is there, or the directory is not writable.
        """
        from hitchopt.directory import save_picture

        write = partial(provided("draw"), self)
        return save_picture(path("directory", directory), self.certificate, write)

    def _write_report(self, file: Path, directory: Path, ghost: Path | str | None = None) -> None:
        """Write the report, with the digests of the plan's files in ``directory``."""
        content = self.flight, self.certificate, self.title, self.problem
        provided("report")(file, *content, directory, ghost)

    def report(self, directory: Path | str, *, ghost: Path | str | None = None) -> Path:
        """Write ``report.html``, one file that needs no network, into the plan's directory.

        ``ghost`` is the file or directory of another plan, a simulated flight or an evaluation to
        show for comparison.
        """
        from hitchopt.directory import REPORT

        folder = path("directory", directory)
        writers = {REPORT: lambda file: self._write_report(file, folder, ghost)}
        return replace_files(folder, writers, (REPORT,), seal=REPORT) / REPORT

    def view(
        self,
        save: Path | str | None = None,
        *,
        ghost: Path | str | None = None,
        width: float | None = None,
        height: float | None = None,
        panels: Sequence[str] | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        browser: bool = True,
        progress: Progress | None = None,
    ) -> LiveView | None:
        """Show the plan live in the browser, or write it to a file.

        The returned view is served until it is closed or Python ends.

        Parameters
        ----------
        save: file to write instead of serving: .html is the report; .png, .svg and .pdf the
            summary; .mp4 and .gif a film in real time.
        ghost: file or directory of another plan, a simulated flight or an evaluation to show for
            comparison.
        width: of a saved picture [inch], a figure for a paper with text of 8 pt; by default it is
            one for screens.
        height: of that figure [inch]; by default it follows from its parts.
        panels: its parts, some of ``plan``, ``separation``, ``speed`` and ``thrust``; all by
            default.
        host, port: address to listen on; if the port is in use, the next free one.
        browser: whether to open the browser.
        progress: status callback for films.

        Raises
        ------
        InputError, FileError: unknown suffix of the file, or a file that is not accessible.
        UnsupportedError: viser, or a library to write films, is not installed.
        """
        shown: LiveView | None = provided("view")(
            self,
            save,
            ghost=ghost,
            figure=(width, height, panels),
            address=(host, port),
            browser=browser,
            progress=progress,
        )
        return shown

    def export(
        self, format: str, folder: Path | str, *, progress: Progress | None = None, **options: Any
    ) -> tuple[Export, ...]:
        """Write the plan in a fleet's format; return one entry per part of the plan.

        The files are read back and certified; an export that violates a limit is refused.
        Setpoints of uploads hold the cables' tension; uploads are refused if the stiffness of the
        position loops is unknown, unless ``allow_slack`` is set.

        Parameters
        ----------
        format: crazyswarm2, compressed, skybrush, mavsdk_drone_show, ros2bag, csv, parquet,
            gltf, mjcf, or a format that another package registers.
        folder: created if it is missing; only files of an earlier export are replaced.
        progress: status callback.
        options: keywords of ``hitchopt.exports.options.ExportOptions``, all optional.

        Raises
        ------
        InputError, FileError: an argument is invalid, or a file cannot be written.
        CertificateError, InfeasibleError: the certificate does not hold, the format cannot hold
            the plan or its tension, or a limit is violated in the format; nothing is written.
        UnsupportedError: a library that the format needs is not installed, or the package that
            registers the format has none that can be used.
        """
        place = path("folder", folder)
        self.certificate.raise_if_violated()
        saved = SavedPlan(self.flight, self.title, self.problem, self.stated_rules)
        exports: tuple[Export, ...] = provided("export")(
            saved, text("format", format), place, progress, options
        )
        return exports

    def compressed(self, **options: Any) -> tuple[dict[str, bytes], ...]:
        """Return the bytes of every drone's compressed trajectory for Crazyflies, by name.

        There is one entry per part of the plan, usually one; each is certified like an export.
        Drones must ``goTo`` their hover position before the next part is uploaded: an upload
        overwrites the memory from which a finished trajectory is still evaluated. Options and
        errors are those of ``export``.
        """
        with tempfile.TemporaryDirectory() as scratch:
            return tuple(
                {
                    Path(name).stem.rpartition("_")[0]: (part.folder / name).read_bytes()
                    for name in part.files
                }
                for part in self.export("compressed", Path(scratch) / "bytes", **options)
            )


@suggest_keywords
def closest(
    plan: Plan,
    spans: int = CLOSENESS_SPANS,
    picture: Path | str | None = None,
    width: float | None = None,
) -> Closeness:
    """Return the closest pairs of drones over time, with bounds that hold for all t.

    Parameters
    ----------
    plan: a plan of at least two drones.
    spans: number of time intervals of equal length; the closest pair of each is returned.
    picture: file to draw the result to (.png, .svg or .pdf), or None.
    width: of the picture [inch], then a figure for a paper with text of 8 pt.
    """
    check_instance("plan", plan, Plan)
    pairs = closeness(plan.flight, integer("spans", spans, 1))
    if picture is not None:
        picture = path("picture", picture)
        provided("draw_closeness")(plan.flight, pairs, width, picture)
    return pairs


@suggest_keywords
def combine(plan: Plan, other: Plan, at: float = 0.0, names: tuple[str, str] = ("a", "b")) -> Plan:
    """Return two plans as one, certified for the limits of both and the distances between them.

    Nothing is replanned or refused: the certificate reports violations, and ``closest`` the closest
    pairs of drones. Custom rules are listed as not recomputed.

    Parameters
    ----------
    plan, other: the plans; their drones rest before the start and after the end.
    at: start time of ``other`` on the clock of ``plan``, at least 0 [s].
    names: prefixes of the drones' names: ``a.q0``, ``b.q0``.

    Raises
    ------
    InputError: an argument is invalid.
    """
    check_instance("plan", plan, Plan)
    check_instance("other", other, Plan)
    at = nonnegative("at", at)
    first, second = (NAME.check(f"names[{k}]", name) for k, name in enumerate(names))
    other_teams, others = (
        [replace(each, motion=shifted(each.motion, at)) for each in teams]
        for teams in (other.flight.teams, other.flight.others)
    )
    teams = [*named_teams(first, plan.flight.teams), *named_teams(second, other_teams)]
    flight = Flight(tuple(teams), (*plan.flight.others, *others))
    title = " and ".join(filter(None, (plan.title, other.title)))
    rules = tuple(dict.fromkeys((*plan.stated_rules, *other.stated_rules)))
    return Plan(flight, certify(flight).stating(rules), title)


@suggest_keywords
def load(directory: Path | str) -> Plan:
    """Return the plan in a directory; its certificate is recomputed from the polynomials.

    Custom rules are listed as not recomputed: ``certify(plan, rules=[…])`` recomputes them.
    Raises FileError if there is no plan, it is damaged, or its flight does not match its request.
    """
    saved = read_requested_plan(path("directory", directory) / PLAN)
    return Plan(saved.flight, certify(saved), saved.title, saved.problem)


def read_requested_plan(file: Path) -> SavedPlan:
    """Return the contents of a plan file; raises FileError if its problem requests another plan."""
    saved = read_saved_plan(file)
    for rule in saved.stated_rules:
        if rule.name in NAMES:
            raise FileError(f"{file}: a rule has the name of a check, {rule.name}; solve it again")
    if saved.problem:
        from hitchopt.mission.loading import request_in  # heavy

        try:
            request = request_in(saved.problem, saved.flight.requirements.objects)
            check_request(request, saved.flight)
        except InputError as error:
            reason = " ".join(str(error).split())
            raise FileError(f"{file}: the problem in it differs: {reason}") from error
        for contradictions in hooks("contradictions"):
            if differences := contradictions(file):
                messages = (f"{file}: {each}" for each in differences)
                raise FileError("\n".join(messages))
    return saved
