"""Makes the .mat files beside it, with readers' and writers' own libraries: pip install numpy scipy h5py; python make.py

12 frames of 6×8 pixels: red (3t + 10y + 7x) mod 256, green (5t + 20y + 3x) mod 256, blue (9t + y + 17x) mod 256, over 255.
The pulse is sin(k / 3), 24 samples in MMPD's files and 12 in SCAMPS's.
"""
import h5py
import numpy as np
import scipy.io

T, H, W = 12, 6, 8
t, y, x = np.meshgrid(np.arange(T), np.arange(H), np.arange(W), indexing="ij")
codes = np.stack([3 * t + 10 * y + 7 * x, 5 * t + 20 * y + 3 * x, 9 * t + y + 17 * x], axis=-1) % 256
video = codes / 255
pulse = np.sin(np.arange(24) / 3)
labels = dict(light="LED-low", motion="Stationary (after exercise)", exercise="True", skin_color=5, gender="female",
              glasser="False", hair_cover="False", makeup="True")
mmpd = dict(video=video.astype(np.float32), GT_ppg=pulse[None, :], **labels)
scipy.io.savemat("mmpd_plain.mat", mmpd)
scipy.io.savemat("mmpd_compressed.mat", mmpd, do_compression=True)
# Other classes than usual, and variables that are none of ours.
odd = dict(video=codes.astype(np.uint8), GT_ppg=(1000 * pulse[:, None]).astype(np.int16),
           cell=np.array([1, "a", [2]], dtype=object), st=dict(a=1, b="x"), **labels)
scipy.io.savemat("mmpd_odd.mat", odd, do_compression=True)
# MATLAB 7.3 is HDF5 behind a block of 512 bytes, axes reversed.
with h5py.File("scamps.mat", "w", userblock_size=512) as file:
    reversed_axes = np.ascontiguousarray(video.transpose(3, 2, 1, 0))
    file.create_dataset("Xsub", data=reversed_axes, chunks=(1, 4, 3, 12), compression="gzip")
    file.create_dataset("d_ppg", data=pulse[:T].reshape(T, 1))
with open("scamps.mat", "r+b") as file:
    file.write((b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM").ljust(512, b"\0"))
