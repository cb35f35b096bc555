"""The surfaces of a map as vertex and face arrays. World frame.

Roads are strips along their lines; junctions, their walkways and islands are areas; terrain is what both leave.
"""
