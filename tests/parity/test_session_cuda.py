"""Sessions on the device: gone back in, recorded and repeated to the same bytes, as on the CPU."""

from __future__ import annotations

from heartcase.schemas.recording.commands import AddSprings, BringProbe, CloseGrab, LeadGrab, MoveProbe, OpenGrab
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.engine.cuda.intrinsics import IS_SIMULATED
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.simulator.simulation import Simulation
from tests.simulator.lattices import block
from tests.simulator.session.sessions import fingerprint

STEPS = 2 if IS_SIMULATED else 200
SIZE = (3, 2, 3) if IS_SIMULATED else (60, 30, 30)
LAWS = ("element",) if IS_SIMULATED else ("springs", "element")


def test_gone_back_recorded_and_repeated(tmp_path):
    for law in LAWS:
        model = block(*SIZE, fix_base=True, cell_mm=2.0)
        top = 2.0 * SIZE[2]
        session = OperatingSession(Simulation(model.with_law(ForceLaw(law)), backend="cuda"), snapshot_every_s=0.0)
        with Recorder(session, tmp_path / f"{law}.recording", state_every_s=STEPS * session.simulation.step_s):
            session.do(CloseGrab(name="hand", center_mm=(0, 0, top), radius_mm=2.5))
            session.do(LeadGrab(name="hand", offset_mm=(0.1, 0, 0.3)))
            session.advance(STEPS)
            session.do(AddSprings(nodes=((0, model.node_count - 1),), stiffness_n_m=0.01))
            session.do(BringProbe(name="tip", center_mm=(4, 4, top + 2), semi_axes_mm=(2, 2, 2)))
            session.do(MoveProbe(name="tip", center_mm=(4, 4, top + 1)))
            session.advance(STEPS)
            middle = fingerprint(session.simulation)
            session.do(OpenGrab(name="hand"))
            session.advance(STEPS)
            end = fingerprint(session.simulation)
            session.undo()
            assert fingerprint(session.simulation) == middle
            session.redo()
            assert fingerprint(session.simulation) == end
        again = load_session(open_recording(tmp_path / f"{law}.recording"), model)
        for _ in again.play():
            pass
        assert again.deviations == []
        assert fingerprint(again.simulation) == end
