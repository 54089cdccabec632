"""Independent verification of a plan: proofs of all limits from ``plan.npz`` by samples and rates.

``python -m hitchopt.verify DIR`` needs numpy and the standard library alone, as does a copy of this
folder. The file format is that of docs/reference/files.md.
Neither code nor method is shared with hitchopt, whose certificate encloses quantities by Bernstein
coefficients. Here a quantity is computed at the midpoint of a time span, and its rate of change is
bounded: with a slope g at the midpoint, slopes within q of g on the span, and half the duration t
of the span, the quantity stays within ``(|g| + q) t`` of its value at the midpoint. For a
polynomial, q is t times the largest coefficient of its second derivative; sums, products, norms and
directions follow from the chain rule (class ``Line``). Spans are halved until the limit is proven
on all of them (``proven``), violated at a sample (``violated``), or the effort is exhausted (``not
proven``): values of curves are read, 16 more are counted for each sample, and all proofs together
may take 40 million, besides 30 times what the first passes over whole pieces take.

Rounding: a polynomial has an error of ``2**-48`` of its coordinates, its k-th derivative one of
``2**-48 2^k N!/(N-k)! / h^k`` of its largest difference of consecutive coefficients (degree N,
duration h of a piece). As in the certificate, the tolerance of a limit is 1e-9 of the largest of
itself and the coordinates. With ``limits.tracking``, distances are proven twice: of the plan, as in
the certificate, and with the tracking errors of all drones, which bound ``tracking_radius``.
Excluded are ``stoppable``, and the tracking radius unless it is limited.

To read it, begin with ``plan.py`` (what a file has), ``arithmetic.py`` and ``spans.py`` (what a
proof is), and ``cables.py`` (the formulas of taut cables); ``driver.py`` has the order of rows.
"""

from .driver import PASSING as PASSING
from .driver import cells as cells
from .driver import main as main
from .driver import verdict as verdict
from .driver import verify as verify
from .plan import Plan as Plan
from .reading import UnreadableError as UnreadableError
from .reading import read as read
from .request import requested as requested
from .spans import NOTHING as NOTHING
from .spans import Row as Row
