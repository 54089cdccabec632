"""Floor 6: one check a file, from a plan's polynomials only. Imports no planner."""

from hitchopt.checks.certificate import Certificate, CertificateError, Check
from hitchopt.checks.certify import certify, merged

__all__ = ["Certificate", "CertificateError", "Check", "certify", "merged"]
