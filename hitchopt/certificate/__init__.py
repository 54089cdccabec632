"""Floor 6: one check a file, from a plan's polynomials only. Imports no planner."""

from hitchopt.certificate.certify import certify
from hitchopt.certificate.merge import merged
from hitchopt.certificate.report import Certificate, CertificateError, Check

__all__ = ["Certificate", "CertificateError", "Check", "certify", "merged"]
