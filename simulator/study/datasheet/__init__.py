"""Datasheet of a star sensor in the words of ECSS-E-ST-60-20C, measured on simulated frames."""
