"""Stereo visual odometry, by which exposure is judged: how well would a robot know its way on these images?"""
