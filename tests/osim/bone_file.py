"""A small surface in the format of OpenSim's bones."""

#: Four triangles, two of which are one square.
TETRAHEDRON = """<?xml version="1.0"?>
<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData>
<Piece NumberOfPoints="5" NumberOfPolys="3">
 <PointData><DataArray type="Float32" Name="Normals" format="ascii">1 0 0</DataArray></PointData>
 <Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">
  0 0 0  1 0 0  1 1 0  0 1 0  0 0 1</DataArray></Points>
 <Polys>
  <DataArray type="Int32" Name="connectivity" format="ascii">0 1 2 3 0 1 4 1 2 4</DataArray>
  <DataArray type="Int32" Name="offsets" format="ascii">4 7 10</DataArray>
 </Polys>
</Piece></PolyData></VTKFile>
"""
