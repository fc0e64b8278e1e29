"""Driving a course with boundaries and obstacles as fast as the laser sees far enough."""
