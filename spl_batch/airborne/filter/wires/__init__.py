"""Scan for conductors: lines of returns too weak for a test of single points."""
