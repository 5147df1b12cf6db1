"""The exported C, compiled and measured, and centroid lists to try it with."""
