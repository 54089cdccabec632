"""The certificate, from polynomials alone: a module a family of checks, no planner."""

from hitchopt.checks.certificate import Certificate, CertificateError, Check
from hitchopt.checks.registry import certify, merged

__all__ = ["Certificate", "CertificateError", "Check", "certify", "merged"]
