"""PSNR and seconds of ``denoise_image`` beside BM3D, BM4D, and scikit-image's filters tuned by an oracle.

    export GPUREG_DATA=...                     # the folder of test data: its pictures
    python -m bench.quality                    # everything: hours, most of it the peers
    python -m bench.quality --peers peers.json # reads what is there, computes and adds what is not: may be interrupted
    python -m bench.quality --only camera --only house --sigma 20 --seeds 1 --json out.json --plot cost.svg
    python -m bench.quality --only real        # photon noise, a JPEG
    python -m bench.quality --from out.json --plot cost.png       # show an earlier run again, without measuring

Images hold float64 in [0, 255]: the ten pictures of the README, texts, cells and the moon of scikit-image, two volumes,
and a series (``synthetic.py``). The noise is ``default_rng(seed).standard_normal(shape) * sigma`` for three seeds, for
volumes one; nothing is clipped, neither the noisy image nor a result, and the PSNR is that of a range of 255.

Ours choose by themselves, but for "sigma given". BM3D (package bm3d: pictures) and BM4D (bm4d: volumes and series) are
told the true sigma. Filters of scikit-image are told it where they take it, and every other parameter is chosen by the
true PSNR (``tuned.py``), on the first seed's noise. A peer that is not installed has no numbers.

bm3d and bm4d are free for noncommercial research only. They are never a dependency of this project, nothing of them or
made by them is part of it, and where their results are published their authors are to be named: K. Dabov et al., "Image
denoising by sparse 3-D transform-domain collaborative filtering", IEEE TIP 16(8), 2007; M. Maggioni et al., "Nonlocal
transform-domain filter for volumetric data denoising and reconstruction", IEEE TIP 22(1), 2013; Y. Makinen et al.,
"Collaborative filtering of correlated noise", IEEE TIP 29, 2020.

Seconds are the least over the seeds, on the same images in one run; ours run once before, so that their kernels are
built. Seconds that --peers has from an earlier run have a star; --time-again calls each of these peers once more.
"""
