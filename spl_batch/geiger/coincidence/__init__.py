"""Coincidence processing of Geiger-mode lidar: detections and looks in, surfaces out [M20].

[M20] is Marchant, Kirkpatrick & Ober, "Coincidence Processing of Photon-Sensitive Mapping
Lidar Data", ERDC/GRL TR-20-1, 2020: the Bridge Sign algorithm.
"""
