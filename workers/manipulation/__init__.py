"""Grasps objects on tables: kinematics, collision checks, planning, and what to do after what."""
