"""``heartcase approve``: note that a case was reviewed and approved."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from heartcase.cli.shared.output import echo_json, echo_warnings
from heartcase.pipeline.warnings import counted, warnings_of
from heartcase.schemas.bundle.approval import approval_log, approve_case, bundle_sha256, report_beside
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.errors import BundleError, UsageError

__all__ = ["command"]


@click.command()
@click.argument("case", type=click.Path(path_type=Path, readable=False))
@click.option("--role", required=True, help='What you are, such as "consultant cardiologist": not your name.')
@click.option("--note", default="", help="What else should be known; never anything about the patient.")
@click.option("--withdraw", is_flag=True, help="Take the approval of this case back.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.option("--json", "as_json", is_flag=True, help="Print the state as JSON.")
def command(case: Path, role: str, note: str, withdraw: bool, yes: bool, as_json: bool) -> None:
    """Check CASE to the last byte, then append who approved it, when, and exactly which bytes, to a log beside it.

    The log is NAME.approvals.jsonl. Change a byte of the case and it is a draft again; build the same bytes again and
    they are approved as before. Warnings that the anatomy may be wrong are asked about by themselves.
    """
    seen = None
    if not withdraw:
        problems = check_bundle(case)
        if problems:
            raise BundleError(problems)
        seen = bundle_sha256(case)
        if report_beside(case, seen) is None:
            click.echo("warning: there is no report beside the case: what was it judged by?", err=True)
        manifest = open_bundle(case).manifest
        click.echo(f"Case       {manifest.name}" + (f" ({manifest.case_id})" if manifest.case_id else ""), err=True)
        click.echo(f"Hash       {seen[:16]}, as on the report", err=True)
        worst = echo_warnings(warnings_of(manifest), err=True)
        click.echo(manifest.notice, err=True)
        if worst:
            _confirm_anatomy(worst, yes=yes)
    if not yes:
        act = "withdraw the approval of" if withdraw else "approve"
        _confirm(f"Do you, as {role!r}, {act} this case as it is?")
    state = approve_case(case, role=role, note=note, withdraw=withdraw, expected_sha256=seen)
    if as_json:
        echo_json(state.as_dict() | {"log": str(approval_log(case))})
    else:
        click.echo(f"{state.words}; noted in {approval_log(case)}")


def _confirm_anatomy(count: int, *, yes: bool) -> None:
    """Say once more how many warnings are the worst, and ask about them alone: among others they are passed over."""
    says = f"{counted(count, 'warning')} {'says' if count == 1 else 'say'} that the anatomy may be wrong"
    if yes:
        click.echo(f"{says}: approved all the same, because of --yes", err=True)
    else:
        _confirm(f"{says}. Have you compared {'this place' if count == 1 else 'these places'} with the scan?")


def _confirm(question: str) -> None:
    try:
        if click.confirm(question, err=True):
            return
    except click.exceptions.Abort:
        if sys.stdin.isatty():
            raise
        click.echo(err=True)
        raise UsageError(
            "nobody is there to answer (no terminal), nothing was noted: add --yes where you have made up your mind"
        ) from None
    raise UsageError("not confirmed: nothing was noted")
