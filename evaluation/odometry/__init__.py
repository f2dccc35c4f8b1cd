"""Stereo visual odometry, which judges exposure: how well would a robot find its way with these images?"""
