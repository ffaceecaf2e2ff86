"""Classes of delivered points, in the codes of the ASPRS."""
