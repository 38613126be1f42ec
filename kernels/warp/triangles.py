"""The inverse of a group's matrix as two triangles, and patches times it, in tiles of 4 rows.

  C + S = U^T U (Cholesky),   Z = U^-1,   Z Z^T = (C + S)^-1

We apply Z and Z^T one after the other instead of (C + S)^-1: its rounding errors times a patch can have the size of
cond(C + S) roundings of the patch, those of Z only that of its square root.

C++ with the names of lanes.py, M rows of a matrix and a pitch of P numbers, a multiple of 4 and of N. Rows beyond the
end of a table are computed too, and not used. Columns M to P - 1 of tables of patches are zeros.
"""

SOURCE = """
    struct One { enum { U = 1 }; };
    struct Two { enum { U = 2 }; };
    // A tile: 4 rows of two packs that begin at column q; the last one of a row may be one pack
    const int wide = 2 * N, across = (P / N + 1) / 2;
    auto packs = [&](int q) -> int { return q + wide <= P ? 2 : 1; };
    auto add_product = [&](auto width, const T* left, int step, int next, const T* right, int count, V* sum) {
        constexpr int U = decltype(width)::U;
        V s0[U], s1[U], s2[U], s3[U];
        for (int k = 0; k < U; ++k) {
            s0[k] = sum[k];
            s1[k] = sum[2 + k];
            s2[k] = sum[4 + k];
            s3[k] = sum[6 + k];
        }
        for (int l = 0; l < count; ++l) {
            const T* a = left + l * step;
            const T a0 = a[0], a1 = a[next], a2 = a[2 * next], a3 = a[3 * next];
            for (int k = 0; k < U; ++k) {
                const V x = load(right + l * P + k * N);
                s0[k] += a0 * x;
                s1[k] += a1 * x;
                s2[k] += a2 * x;
                s3[k] += a3 * x;
            }
        }
        for (int k = 0; k < U; ++k) {
            sum[k] = s0[k];
            sum[2 + k] = s1[k];
            sum[4 + k] = s2[k];
            sum[6 + k] = s3[k];
        }
    };
    // add to row a of a tile the sum over l of left[l step + a next] times row l of `right`
    auto multiply = [&](int q, const T* left, int step, int next, const T* right, int count, V* sum) {
        if (packs(q) == 2)
            add_product(Two(), left, step, next, right + q, count, sum);
        else
            add_product(One(), left, step, next, right + q, count, sum);
    };
    // row a of a tile = -(the sum over b of factors[a step + b next] times row b of x)
    auto mix = [&](int q, const T* factors, int step, int next, const V* x, T* to) {
        for (int a = 0; a < 4; ++a)
            for (int k = 0; k < packs(q); ++k) {
                V row = V{};
                for (int b = 0; b < 4; ++b)
                    row -= factors[a * step + b * next] * x[2 * b + k];
                store(to + a * P + q + k * N, row);
            }
    };
    // Replace C in K, given on and above the diagonal, by Z^T, and write Z; S: the diagonal; F: room for 4 P numbers.
    auto factor = [&](T* K, T* Z, const T* S, T* F) {
        // K = U above the blocks on the diagonal
        for (int k = 0; k < M; k += 4) {
            T* const rows = K + k * P;
            const int from = k / wide * wide;
            // minus what the rows above leave of these
            for (int q = from + lane * wide; q < P; q += LANES * wide) {
                V sum[8];
                for (int a = 0; a < 4; ++a)
                    for (int p = 0; p < packs(q); ++p)
                        sum[2 * a + p] = -load(rows + a * P + q + p * N);
                multiply(q, K + k, P, 1, K, k, sum);
                for (int a = 0; a < 4; ++a)
                    for (int p = 0; p < packs(q); ++p)
                        store(rows + a * P + q + p * N, sum[2 * a + p]);
            }
            WP_GPUREG_SYNC();
            T lower[16], inverse[16];  // of the block; the diagonal of `lower` is inverted
            for (int i = 0; i < 4; ++i)
                for (int j = 0; j <= i; ++j) {
                    T sum = -rows[j * P + k + i];
                    if (i == j)
                        sum = k + i < M ? sum + S[k + i] : T(1);
                    for (int l = 0; l < j; ++l)
                        sum -= lower[4 * i + l] * lower[4 * j + l];
                    lower[4 * i + j] = i == j ? T(1) / sqrt(sum) : sum * lower[5 * j];
                }
            for (int j = 0; j < 4; ++j)
                for (int i = 0; i < 4; ++i) {
                    T sum = i == j ? T(1) : T(0);
                    for (int l = j; l < i; ++l)
                        sum -= lower[4 * i + l] * inverse[4 * l + j];
                    inverse[4 * i + j] = i < j ? T(0) : sum * lower[5 * i];
                }
            _Pragma("unroll") for (int i = 0; i < 16; ++i)
                if (i % LANES == lane)
                    F[4 * k + i] = inverse[i];
            WP_GPUREG_SYNC();
            for (int q = from + lane * wide; q < P; q += LANES * wide) {
                V x[8];
                for (int a = 0; a < 4; ++a)
                    for (int p = 0; p < packs(q); ++p)
                        x[2 * a + p] = load(rows + a * P + q + p * N);
                mix(q, inverse, 4, 1, x, rows);
            }
            WP_GPUREG_SYNC();
        }
        // Z, from the last rows, with zeros left of the diagonal in a tile
        for (int k = (M - 1) / 4 * 4; k >= 0; k -= 4) {
            const int last = (M + 3) / 4 * 4;
            for (int q = k / wide * wide + lane * wide; q < P; q += LANES * wide) {
                V sum[8] = {};
                const int end = q + wide < last ? q + wide : last;
                multiply(q, K + k * P + k + 4, 1, P, Z + (k + 4) * P, end - (k + 4), sum);
                mix(q, F + 4 * k, 1, 4, sum, Z + k * P);
                for (int j = q > k ? q : k; j < k + 4 && j < q + wide; ++j)
                    for (int a = 0; a < 4; ++a)
                        Z[(k + a) * P + j] = F[4 * k + 4 * (j - k) + a];
            }
            WP_GPUREG_SYNC();
        }
        // K = Z^T, with zeros right of the diagonal in a tile
        for (int i = 0; i < M; ++i)
            for (int j = lane; j < P && j < i / wide * wide + wide; j += LANES)
                K[i * P + j] = Z[j * P + i];
    };
    // Replace n patches x of X by S Z Z^T x; Y: room for them.
    auto solve = [&](T* X, int n, T* Y, const T* K, const T* Z, const T* S) {
        for (int job = lane; job < (n + 3) / 4 * across; job += LANES) {
            const int v = job / across * 4, q = job % across * wide;
            V sum[8] = {};
            multiply(q, X + v * P, 1, P, Z, q + wide < M ? q + wide : M, sum);
            for (int a = 0; a < 4; ++a)
                for (int k = 0; k < packs(q); ++k)
                    store(Y + (v + a) * P + q + k * N, sum[2 * a + k]);
        }
        WP_GPUREG_SYNC();
        for (int job = lane; job < (n + 3) / 4 * across; job += LANES) {
            const int v = job / across * 4, q = job % across * wide;
            V sum[8] = {};
            multiply(q, Y + v * P + q, 1, P, K + q * P, M - q, sum);
            for (int a = 0; a < 4 && v + a < n; ++a)
                for (int k = 0; k < packs(q); ++k)
                    store(X + (v + a) * P + q + k * N, sum[2 * a + k] * load(S + q + k * N));
        }
        WP_GPUREG_SYNC();
    };
"""
