"""From case to motion: the spring lattice, its kernels, hands and surface.

The story is :class:`heartcase.simulator.simulation.Simulation`; a case comes from
:func:`heartcase.simulator.load.load_case`, a lattice without a case from
:func:`heartcase.simulator.lattice.model.make_model`::

    case = load_case("heart.case", needs=("surface",))
    simulation = Simulation(case.model, surface=case.surface)
    hand = simulation.grab((12.0, -80.0, 40.0), radius_mm=8.0)
    simulation.lead(hand, (0.0, 0.0, 5.0))
    simulation.step(100)
    simulation.surface_now().vertices_mm

Constant arrays are a :class:`~heartcase.simulator.lattice.model.LatticeModel`, what changes is a
:class:`~heartcase.simulator.lattice.state.State`, and an :class:`~heartcase.simulator.engine.backends.Engine` takes one
to the next.
"""
