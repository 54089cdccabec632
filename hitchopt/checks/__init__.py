"""The certificate, computed from polynomials alone: one module per family of checks, no planner."""

from hitchopt.checks.certificate import Certificate, CertificateError, Check
from hitchopt.checks.certifying import certify, merged

__all__ = ["Certificate", "CertificateError", "Check", "certify", "merged"]
