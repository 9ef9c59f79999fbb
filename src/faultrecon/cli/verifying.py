# SPDX-License-Identifier: BSD-3-Clause
"""The verb `verify`: the certificate of a design, or of every design of a bank, by the standard library alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from faultrecon.certificate import Certificate, load_certificate, read_document
from faultrecon.finding import FaultreconError, InputError


def verified(file: str) -> tuple[bool, dict[str, Any], str]:
    """Whether nothing is refuted, the verdict as data and as text.

    Raises InputError on a file that is neither, and on designs that carry no certificate.
    """
    try:
        document = read_document(file, "bank")
    except InputError:
        return _of_design(load_certificate(file))  # which says what is wrong with a file that is none of both
    return _of_bank(file, document)


def _of_design(certificate: Certificate) -> tuple[bool, dict[str, Any], str]:
    found = certificate.verify()
    text = f"{found}\n  claim: {certificate.claim}\n  with γ = {certificate.level:.9g}\n  scope: {certificate.scope}"
    extra = {"claim": certificate.claim, "level": certificate.level, "scope": certificate.scope}
    return found.sound, found.as_dict() | extra, text


def _of_bank(file: str, document: Mapping[str, Any]) -> tuple[bool, dict[str, Any], str]:
    """One row for each design; a step that is refuted is shown below it."""
    designs = document.get("designs")
    if not isinstance(designs, Mapping) or not designs:
        raise InputError(f"{file}: holds no design", remedies=("make the bank again",))
    certificates = {str(name): _certificate(f"{file}: {name}", one) for name, one in designs.items()}
    width = max(map(len, certificates))
    data, lines, refuted = {}, [], []
    for name, certificate in certificates.items():
        sound, data[name], _ = _of_design(certificate)
        lines.append(f"{name:{width}}  {data[name]['verdict']}: γ = {certificate.level:.9g}; {certificate.claim}")
        bad = [step for step in data[name]["steps"] if step["verdict"] == "refuted"]
        lines += [f"{'':{width}}    {step['label']}: {step['how']}" for step in bad]
        refuted += [] if sound else [name]
    lines.append(f"refuted: {', '.join(refuted)}" if refuted else f"{len(certificates)} designs, none refuted")
    return not refuted, {"designs": data, "refuted": refuted}, "\n".join(lines)


def _certificate(where: str, document: Any) -> Certificate:
    try:
        if not isinstance(document, Mapping):
            raise InputError("is damaged", why="it is no design", remedies=("make the bank again",))
        return Certificate.from_document(dict(document))
    except FaultreconError as error:
        raise InputError(f"{where}: {error}") from error
