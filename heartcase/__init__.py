"""heartcase: from a cardiac MRI or CT to a case bundle and a real-time simulation of it.

The names below are what other programs are meant to use: ``from heartcase import load_case``. Each is loaded at its
first use, so that ``import heartcase`` loads neither numba nor SimpleITK. ``docs/api.md`` describes them.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from heartcase.library.build import Workers, build_cases, connected, default_workers, stale_cases
    from heartcase.library.check import CaseCheck, check_case
    from heartcase.library.diff import CaseChange, Tolerances, diff_libraries
    from heartcase.library.plan import CaseRecord, LibraryCase, plan_library
    from heartcase.library.scans import ensure_scan
    from heartcase.pipeline.building.input_check import InputFindings, check_inputs
    from heartcase.pipeline.building.lock import lock_recipe, recipe_text
    from heartcase.pipeline.building.run import BuildResult, build_case
    from heartcase.pipeline.building.runner import BuildListener
    from heartcase.pipeline.building.session_file import RecipeSession, open_session
    from heartcase.pipeline.data import Markers, Scan, Segmentation
    from heartcase.pipeline.formats.dicom.choice import SeriesInfo
    from heartcase.pipeline.formats.labels.segments import LabelVolume
    from heartcase.pipeline.formats.read_scan import list_series, read_labels, read_scan
    from heartcase.pipeline.formats.write_images import write_scan, write_segmentation
    from heartcase.pipeline.image.filter_scan import filter_scan
    from heartcase.pipeline.markers.session import SegmentationSession
    from heartcase.pipeline.markers.suggest import StrokePlace, StrokePlaces
    from heartcase.schemas.bundle.approval import Approval, approval_state, approve_case
    from heartcase.schemas.bundle.check import check_bundle
    from heartcase.schemas.bundle.format import CaseManifest, FileRole
    from heartcase.schemas.bundle.lattice import cell_nodes
    from heartcase.schemas.bundle.reader import OpenBundle, open_bundle
    from heartcase.schemas.errors import (
        BundleError,
        HeartcaseError,
        MarkerError,
        MissingExtraError,
        Problem,
        RecipeError,
        RecordingError,
        ScanError,
        ScriptError,
        SimulationError,
        StageError,
        UnsupportedVersionError,
        UsageError,
    )
    from heartcase.schemas.geometry import Geometry
    from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table
    from heartcase.schemas.landmarks import Landmark
    from heartcase.schemas.recipe.recipe import Recipe, load_recipe, parse_recipe
    from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings, Stroke
    from heartcase.schemas.recording.commands import (
        AddSprings,
        Advance,
        BringProbe,
        CloseGrab,
        Cut,
        Entry,
        GoTo,
        Halt,
        LeadGrab,
        Mark,
        MoveProbe,
        OpenGrab,
        Redo,
        RemoveSprings,
        Rewind,
        Undo,
        WithdrawProbe,
        parse_command,
    )
    from heartcase.schemas.recording.reader import Recording, check_recording, open_recording
    from heartcase.schemas.recording.suture_commands import (
        DrawStitch,
        Excise,
        PlacePatch,
        PlaceRow,
        PlaceStitch,
        TakeOutPatch,
        TakeOutStitch,
        TieStitch,
    )
    from heartcase.schemas.recording.tool_commands import (
        BringScissors,
        CloseForceps,
        CloseRetractor,
        PlaceScissors,
        Snip,
        SqueezeForceps,
        WithdrawScissors,
    )
    from heartcase.schemas.scripts.script import SimulationScript
    from heartcase.simulator.dynamics.integrate import Energy
    from heartcase.simulator.dynamics.step_size import default_step, step_limit
    from heartcase.simulator.haptics.channel import Channel, Felt
    from heartcase.simulator.haptics.device import DeviceReading, DeviceSpec, device_names
    from heartcase.simulator.haptics.led import LedGrab, LedProbe
    from heartcase.simulator.haptics.mouse_device import MouseFeed, PointerPlane
    from heartcase.simulator.haptics.poses import ToolPose
    from heartcase.simulator.haptics.servo import HapticServo
    from heartcase.simulator.haptics.settings import ServoSettings
    from heartcase.simulator.haptics.tissue_side import FeltInstrument, TissueSide
    from heartcase.simulator.instruments.forceps import Forceps
    from heartcase.simulator.instruments.grab import Grab
    from heartcase.simulator.instruments.probe import Probe
    from heartcase.simulator.instruments.retractor import Retractor
    from heartcase.simulator.instruments.scissors import Scissors
    from heartcase.simulator.instruments.wrench import Wrench
    from heartcase.simulator.lattice.model import GridUnits, LatticeModel, make_model
    from heartcase.simulator.lattice.moduli import ForceLaw
    from heartcase.simulator.lattice.state import State
    from heartcase.simulator.load import Case, ScanVolume, load_case
    from heartcase.simulator.patching.flat_sheets import FlatSheet
    from heartcase.simulator.patching.patches import PatchState
    from heartcase.simulator.patching.templates import write_template
    from heartcase.simulator.session.frame import Frame, InstrumentFrame, Refusal, TopologyChange
    from heartcase.simulator.session.operating_session import Deviation, OperatingSession
    from heartcase.simulator.session.recorder import Recorder
    from heartcase.simulator.session.replay import load_session
    from heartcase.simulator.session.script import (
        SessionSummary,
        default_script,
        load_script,
        run_script,
        with_positions,
    )
    from heartcase.simulator.simulation import Simulation
    from heartcase.simulator.snapshot import Snapshot
    from heartcase.simulator.surface.deform import (
        DeformedSurface,
        PickingModel,
        SurfaceModel,
        make_picking,
        make_surface,
    )
    from heartcase.simulator.surface.write_surface import write_surface
    from heartcase.simulator.suturing.stitches import StitchState
    from heartcase.simulator.watchdog import Watch
    from heartcase.studio.catalogue.site import CatalogueResult, write_catalogue

__version__ = "0.1.0"

__all__ = [
    "AddSprings",
    "Advance",
    "Approval",
    "BringProbe",
    "BringScissors",
    "BuildListener",
    "BuildResult",
    "BundleError",
    "Case",
    "CaseChange",
    "CaseCheck",
    "CaseManifest",
    "CaseRecord",
    "CatalogueResult",
    "Channel",
    "CloseForceps",
    "CloseGrab",
    "CloseRetractor",
    "Cut",
    "DeformedSurface",
    "Deviation",
    "DeviceReading",
    "DeviceSpec",
    "DrawStitch",
    "Energy",
    "Entry",
    "Excise",
    "Felt",
    "FeltInstrument",
    "FileRole",
    "FilterSettings",
    "FlatSheet",
    "ForceLaw",
    "Forceps",
    "Frame",
    "Geometry",
    "GoTo",
    "Grab",
    "GridUnits",
    "Halt",
    "HapticServo",
    "HeartcaseError",
    "InputFindings",
    "InstrumentFrame",
    "Label",
    "LabelTable",
    "LabelVolume",
    "Landmark",
    "LatticeModel",
    "LeadGrab",
    "LedGrab",
    "LedProbe",
    "LibraryCase",
    "Mark",
    "MarkerError",
    "Markers",
    "MissingExtraError",
    "MouseFeed",
    "MoveProbe",
    "OpenBundle",
    "OpenGrab",
    "OperatingSession",
    "PatchState",
    "PickingModel",
    "PlacePatch",
    "PlaceRow",
    "PlaceScissors",
    "PlaceStitch",
    "PointerPlane",
    "Probe",
    "Problem",
    "Recipe",
    "RecipeError",
    "RecipeSession",
    "Recorder",
    "Recording",
    "RecordingError",
    "Redo",
    "Refusal",
    "RemoveSprings",
    "Retractor",
    "Rewind",
    "Role",
    "Scan",
    "ScanError",
    "ScanVolume",
    "Scissors",
    "ScriptError",
    "SegmentSettings",
    "Segmentation",
    "SegmentationSession",
    "SeriesInfo",
    "ServoSettings",
    "SessionSummary",
    "Simulation",
    "SimulationError",
    "SimulationScript",
    "Snapshot",
    "Snip",
    "SqueezeForceps",
    "StageError",
    "State",
    "StitchState",
    "Stroke",
    "StrokePlace",
    "StrokePlaces",
    "SurfaceModel",
    "TakeOutPatch",
    "TakeOutStitch",
    "TieStitch",
    "TissueSide",
    "Tolerances",
    "ToolPose",
    "TopologyChange",
    "Undo",
    "UnsupportedVersionError",
    "UsageError",
    "Watch",
    "WithdrawProbe",
    "WithdrawScissors",
    "Workers",
    "Wrench",
    "__version__",
    "approval_state",
    "approve_case",
    "build_case",
    "build_cases",
    "cell_nodes",
    "check_bundle",
    "check_case",
    "check_inputs",
    "check_recording",
    "connected",
    "default_label_table",
    "default_script",
    "default_step",
    "default_workers",
    "device_names",
    "diff_libraries",
    "ensure_scan",
    "filter_scan",
    "list_series",
    "load_case",
    "load_recipe",
    "load_script",
    "load_session",
    "lock_recipe",
    "make_model",
    "make_picking",
    "make_surface",
    "open_bundle",
    "open_recording",
    "open_session",
    "parse_command",
    "parse_recipe",
    "plan_library",
    "read_labels",
    "read_scan",
    "recipe_text",
    "run_script",
    "stale_cases",
    "step_limit",
    "with_positions",
    "write_catalogue",
    "write_scan",
    "write_segmentation",
    "write_surface",
    "write_template",
]

_MODULES = {
    "heartcase.library.build": ("Workers", "build_cases", "connected", "default_workers", "stale_cases"),
    "heartcase.studio.catalogue.site": ("CatalogueResult", "write_catalogue"),
    "heartcase.library.check": ("CaseCheck", "check_case"),
    "heartcase.library.diff": ("CaseChange", "Tolerances", "diff_libraries"),
    "heartcase.library.plan": ("CaseRecord", "LibraryCase", "plan_library"),
    "heartcase.library.scans": ("ensure_scan",),
    "heartcase.pipeline.building.input_check": ("InputFindings", "check_inputs"),
    "heartcase.pipeline.building.lock": ("lock_recipe", "recipe_text"),
    "heartcase.pipeline.building.run": ("BuildResult", "build_case"),
    "heartcase.pipeline.building.runner": ("BuildListener",),
    "heartcase.pipeline.building.session_file": ("RecipeSession", "open_session"),
    "heartcase.pipeline.data": ("Markers", "Scan", "Segmentation"),
    "heartcase.pipeline.formats.dicom.choice": ("SeriesInfo",),
    "heartcase.pipeline.formats.labels.segments": ("LabelVolume",),
    "heartcase.pipeline.formats.read_scan": ("list_series", "read_labels", "read_scan"),
    "heartcase.pipeline.formats.write_images": ("write_scan", "write_segmentation"),
    "heartcase.pipeline.image.filter_scan": ("filter_scan",),
    "heartcase.pipeline.markers.session": ("SegmentationSession",),
    "heartcase.pipeline.markers.suggest": ("StrokePlace", "StrokePlaces"),
    "heartcase.schemas.bundle.approval": ("Approval", "approval_state", "approve_case"),
    "heartcase.schemas.bundle.check": ("check_bundle",),
    "heartcase.schemas.bundle.format": ("CaseManifest", "FileRole"),
    "heartcase.schemas.bundle.lattice": ("cell_nodes",),
    "heartcase.schemas.bundle.reader": ("OpenBundle", "open_bundle"),
    "heartcase.schemas.errors": (
        "BundleError",
        "HeartcaseError",
        "MarkerError",
        "MissingExtraError",
        "Problem",
        "RecipeError",
        "RecordingError",
        "ScanError",
        "ScriptError",
        "SimulationError",
        "StageError",
        "UnsupportedVersionError",
        "UsageError",
    ),
    "heartcase.schemas.geometry": ("Geometry",),
    "heartcase.schemas.labels": ("Label", "LabelTable", "Role", "default_label_table"),
    "heartcase.schemas.landmarks": ("Landmark",),
    "heartcase.schemas.recipe.recipe": ("Recipe", "load_recipe", "parse_recipe"),
    "heartcase.schemas.recipe.settings": ("FilterSettings", "SegmentSettings", "Stroke"),
    "heartcase.schemas.recording.commands": (
        "AddSprings",
        "Advance",
        "BringProbe",
        "CloseGrab",
        "Cut",
        "Entry",
        "GoTo",
        "Halt",
        "LeadGrab",
        "Mark",
        "MoveProbe",
        "OpenGrab",
        "Redo",
        "RemoveSprings",
        "Rewind",
        "Undo",
        "WithdrawProbe",
        "parse_command",
    ),
    "heartcase.schemas.recording.reader": ("Recording", "check_recording", "open_recording"),
    "heartcase.schemas.recording.suture_commands": (
        "DrawStitch",
        "Excise",
        "PlacePatch",
        "PlaceRow",
        "PlaceStitch",
        "TakeOutPatch",
        "TakeOutStitch",
        "TieStitch",
    ),
    "heartcase.schemas.recording.tool_commands": (
        "BringScissors",
        "CloseForceps",
        "CloseRetractor",
        "PlaceScissors",
        "Snip",
        "SqueezeForceps",
        "WithdrawScissors",
    ),
    "heartcase.schemas.scripts.script": ("SimulationScript",),
    "heartcase.simulator.dynamics.integrate": ("Energy",),
    "heartcase.simulator.dynamics.step_size": ("default_step", "step_limit"),
    "heartcase.simulator.haptics.channel": ("Channel", "Felt"),
    "heartcase.simulator.haptics.device": ("DeviceReading", "DeviceSpec", "device_names"),
    "heartcase.simulator.haptics.led": ("LedGrab", "LedProbe"),
    "heartcase.simulator.haptics.mouse_device": ("MouseFeed", "PointerPlane"),
    "heartcase.simulator.haptics.poses": ("ToolPose",),
    "heartcase.simulator.haptics.servo": ("HapticServo",),
    "heartcase.simulator.haptics.settings": ("ServoSettings",),
    "heartcase.simulator.haptics.tissue_side": ("FeltInstrument", "TissueSide"),
    "heartcase.simulator.instruments.forceps": ("Forceps",),
    "heartcase.simulator.instruments.grab": ("Grab",),
    "heartcase.simulator.instruments.probe": ("Probe",),
    "heartcase.simulator.instruments.retractor": ("Retractor",),
    "heartcase.simulator.instruments.scissors": ("Scissors",),
    "heartcase.simulator.instruments.wrench": ("Wrench",),
    "heartcase.simulator.lattice.moduli": ("ForceLaw",),
    "heartcase.simulator.lattice.model": ("GridUnits", "LatticeModel", "make_model"),
    "heartcase.simulator.lattice.state": ("State",),
    "heartcase.simulator.load": ("Case", "ScanVolume", "load_case"),
    "heartcase.simulator.patching.flat_sheets": ("FlatSheet",),
    "heartcase.simulator.patching.patches": ("PatchState",),
    "heartcase.simulator.patching.templates": ("write_template",),
    "heartcase.simulator.session.script": (
        "SessionSummary",
        "default_script",
        "load_script",
        "run_script",
        "with_positions",
    ),
    "heartcase.simulator.session.frame": ("Frame", "InstrumentFrame", "Refusal", "TopologyChange"),
    "heartcase.simulator.session.operating_session": ("Deviation", "OperatingSession"),
    "heartcase.simulator.session.recorder": ("Recorder",),
    "heartcase.simulator.session.replay": ("load_session",),
    "heartcase.simulator.simulation": ("Simulation",),
    "heartcase.simulator.snapshot": ("Snapshot",),
    "heartcase.simulator.surface.deform": (
        "DeformedSurface",
        "PickingModel",
        "SurfaceModel",
        "make_picking",
        "make_surface",
    ),
    "heartcase.simulator.surface.write_surface": ("write_surface",),
    "heartcase.simulator.suturing.stitches": ("StitchState",),
    "heartcase.simulator.watchdog": ("Watch",),
}
"""Module -> the public names that it defines."""
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

if not TYPE_CHECKING:  # a type checker would take any name for one that there is

    def __getattr__(name: str) -> object:
        """The public object of this name, from its module; it is kept for the next time."""
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        found = getattr(import_module(_MODULE_OF[name]), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    """All names, whether they are loaded by now or not."""
    return sorted({*globals(), *__all__})
