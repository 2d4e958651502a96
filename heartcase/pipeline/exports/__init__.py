"""What a case is written as for other programs: models for printing, meshes for ParaView and finite elements."""
