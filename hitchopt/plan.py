"""A certified plan: sample, save, export and load it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.checks.bounds.closest_pairs import SPANS, Closeness, closeness
from hitchopt.errors import FileError
from hitchopt.exports.directory import PLAN, SUMMARY, save_plan
from hitchopt.exports.export_options import ExportOptions
from hitchopt.exports.exporting import Export
from hitchopt.exports.plan_export import export_motion
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.plan_file import read_plan, read_title
from hitchopt.motion.states import States, states_at
from hitchopt.time_limit import Progress


@dataclass(frozen=True, eq=False)
class Plan:
    """A certified motion of a hitch, or of a swarm without cables.

    Attributes
    ----------
    motion: the polynomials, with their team and requirements.
    certificate: its checks, valid for all t.
    title: the problem's title.
    """

    motion: Motion
    certificate: Certificate
    title: str = ""

    @property
    def duration(self) -> float:
        """Duration of all steps together [s]."""
        return self.motion.duration

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The time spans of the steps, in order."""
        return self.motion.phases

    def at(self, t: ArrayLike) -> States:
        """Return the states of drones and vertices at times t (…) [s]: arrays of leading shape (…).

        A plan stays at rest after its end.

        Raises
        ------
        InputError: a time before the start, or one that is not finite.
        """
        return states_at(self.motion, t)

    def save(
        self, directory: Path | str, rate: float = 100.0, progress: Progress | None = None
    ) -> Path:
        """Write plan, setpoints at ``rate`` [Hz], certificate and picture; return the directory.

        Either all files are written or none, even if the process is killed; only files of these
        names are replaced.

        Raises
        ------
        CertificateError: the certificate does not hold.
        InputError: a rate that is not positive.
        FileError: the directory cannot be written to.
        """
        from hitchopt.view.summary import save_summary

        motion = self.motion

        def draw(path: Path) -> None:
            save_summary(path, motion, self.certificate, self.title)

        def share(fraction: float) -> None:
            if progress is not None:
                progress(f"writing setpoints, {fraction:.0%}")

        return save_plan(
            directory, motion, self.certificate, self.title, rate, {SUMMARY: draw}, share
        )

    def export(
        self, format: str, folder: Path | str, *, progress: Progress | None = None, **options: Any
    ) -> tuple[Export, ...]:
        """Write the plan in a fleet's format; return what was written, one entry per part.

        The certificate is computed for the files: an export that breaks a limit is refused.

        Parameters
        ----------
        format: crazyswarm2, compressed, skybrush, skybrush_csv, mavsdk_drone_show, ros2bag, csv,
            parquet, npz or json.
        folder: made if it is missing; only files of an earlier export there are replaced.
        progress: called with what is being done now.
        options: the keywords of ``ExportOptions``, all optional.

            - frame: enu, nwu or ned; None for the format's usual one.
            - origin: where the plan's origin lies in the file's frame, east, north and up (3,) [m].
            - yaw: angle by which the plan is turned there, counter-clockwise from above [rad].
            - fleet: path of a fleet file; None calls the drones as the plan does.
            - rate: samples a second [Hz], where the format samples; None for its usual rate.
            - stretch: factor of all durations, from 1 on.
            - storage: storage format of a bag, mcap or sqlite3.
            - ros_distro: the ROS 2 release that a bag is for, humble, iron or jazzy; later ones
              read bags for earlier ones.
            - hold_tension: move set points outward, for controllers that do not feed the cable
              force forward.
            - stiffness, damping: of these controllers [N/m], [N s/m]; None for the team's
              stiffness and a damping ratio of 5/6.

        Raises
        ------
        InputError, FileError: an argument is wrong in itself, or a file cannot be written.
        CertificateError, InfeasibleError: the certificate does not hold, the format cannot hold
            the plan, or a limit is broken in the format; nothing is written.
        UnsupportedError: a library that the format needs is not installed.
        """
        chosen = ExportOptions(format, **options)
        return export_motion(self.motion, self.title, chosen, folder, progress)

    def compressed(self, **options: Any) -> tuple[dict[str, bytes], ...]:
        """Return the bytes of every drone's compressed trajectory for Crazyflies, by name.

        There is one entry per part of the plan, usually one; each is certified like an export.
        Drones must ``goTo`` the point where they hover before the next part is uploaded: an upload
        overwrites the memory from which a finished trajectory is still evaluated.

        Parameters
        ----------
        options: the arguments ``frame``, ``origin``, ``yaw``, ``fleet``, ``stretch`` of ``export``.

        Raises
        ------
        InputError, FileError, CertificateError, InfeasibleError: see ``export``.
        """
        with tempfile.TemporaryDirectory() as place:
            return tuple(
                {
                    Path(name).stem.rpartition("_")[0]: (part.folder / name).read_bytes()
                    for name in part.files
                }
                for part in self.export("compressed", Path(place) / "bytes", **options)
            )


def closest(plan: Plan, spans: int = SPANS, picture: Path | str | None = None) -> Closeness:
    """Return the closest pairs of drones over time, with bounds that hold for all t.

    Parameters
    ----------
    plan: a plan of at least two drones.
    spans: number of equal parts of its time; each has the pair that comes closest in it.
    picture: file to draw the result to (PNG), or None.

    Raises
    ------
    InputError: there is a single drone, or no span.
    FileError: the picture cannot be written.
    """
    found = closeness(plan.motion, spans)
    if picture is not None:
        from hitchopt.view.closeness_picture import save_closeness

        try:
            save_closeness(picture, plan.motion, found)
        except OSError as error:
            raise FileError(f"{picture}: cannot be written: {error.strerror}") from error
    return found


def load(directory: Path | str) -> Plan:
    """Return the plan in a directory; its certificate is recomputed from its polynomials.

    Raises
    ------
    FileError: there is no plan, or its file is damaged.
    """
    path = Path(directory) / PLAN
    motion = read_plan(path)
    return Plan(motion, certify(motion), read_title(path))
