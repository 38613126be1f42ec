/* The rows of a stored graph in the two forms for a GPU. csr.cl includes this file instead of its own rows.
 *
 * SLICED: rows of similar lengths. A slice is 32 rows, and edge j of row u is at slices[u / 32] + 32 j + u % 32, so
 * that neighbouring work items read neighbouring numbers. All rows of a slice have room for as many edges as the
 * longest one (SELL-32). One work item: a vertex.
 *
 * TEAM: dense rows, or rows of uneven lengths. A team of TEAM work items has one row, and each of them every TEAM-th
 * edge; COLLECT adds their sums in local memory. The order of the additions depends on the row alone. TEAM divides
 * GROUP, the work items of a group.
 * SPLIT: long rows, those of hubs, are cut into pieces. A team has a whole row or a piece, and stores the sums of a
 * piece. Then the same kernel runs with HUBS: a team has a hub, adds the stored sums in order, and finishes the row. If
 * the kernel goes over the edges once more (OFFSETS), a team has a piece of a hub, and adds the sums of all its pieces.
 */
#ifndef CSR_GPU_CL
#define CSR_GPU_CL

#ifdef SLICED
#define SLICE 32
/* clang-format off */
#define GRAPH_ARGS                                                                                                    \
    const long n,                      /* number of vertices */                                                       \
    __global const long *slices,       /* (slices,): where each slice begins */                                       \
    __global const int *degrees,       /* (n,): the edges of each row */                                              \
    __global const INDEX *indices,     /* (size,): all places of the slices, also those without an edge */            \
    __global const real *weights,      /* (size,): w with WEIGHTED, gamma with GAMMA */                               \
    __global const long *mirror        /* (size,): the index of (v, u); read with GAMMA, and by adjoint */

#define VERTEX                       \
    const long u = get_global_id(0); \
    if (u >= n) return;

#define OFFSETS                                                                                                       \
    for (long e = slices[(ulong)u / SLICE] + (ulong)u % SLICE, last = e + (long)degrees[u] * SLICE; e < last;         \
         e += SLICE) {
#define EDGES                                                                                                         \
    OFFSETS                                                                                                           \
        const long v = indices[e];
/* clang-format on */

#define COLLECT(x, first, channels)
#define ONE_WRITES

#else
#ifndef GROUP
#define GROUP 64
#endif

/* clang-format off */
#define GRAPH_ARGS                                                                                                    \
    const long n,                      /* number of rows, with SPLIT also of pieces; of hubs or pieces with HUBS */   \
    __global const long *starts,       /* (n + 1,): the first edges; with HUBS (n, 2): the first one, and the end */  \
    __global const INDEX *indices,     /* (n_edges,) */                                                               \
    __global const real *weights,      /* (n_edges,), one per directed edge: w with WEIGHTED, gamma with GAMMA */     \
    __global const long *mirror,       /* (n_edges,): the index of (v, u); read with GAMMA, and by adjoint */         \
    __global const INDEX *rows,        /* (n,): the vertices; read with SPLIT and HUBS */                             \
    __global const INDEX *pieces,      /* (n,): number of a piece, or -1; with HUBS (n, 2): the first, and the end */ \
    const long n_pieces,                                                                                              \
    __global real *sums                /* (sums of a vertex, n_pieces) */

#if TEAM == 1
#define TEAM_MEMORY
#define ADDED_BY_TEAM(x, turn) (x)
#else
typedef CONCATENATE(REAL_, 4) four;
#define TEAM_MEMORY __local four memory[2][GROUP / 4];
#define ADDED_BY_TEAM(x, turn) added_by_team(x, memory[turn])
#endif
#ifdef LARGEST
#define ADDED(a, b) fmax(a, b)
#else
#define ADDED(a, b) ((a) + (b))
#endif

#ifdef HUBS
#define ROW                                                                       \
    const long u = there ? rows[row] : 0;                                         \
    const long first_edge = there ? starts[2 * row] : 0, last_edge = there ? starts[2 * row + 1] : 0;
#define EDGES                      \
    for (long e = 0; e < 0; ++e) { \
        const long v = 0;
#define OFFSETS for (long e = first_edge + member; e < last_edge; e += TEAM) {
#define FINISHES true
#else
#ifdef SPLIT
#define ROW                                               \
    const long u = there ? rows[row] : 0;                 \
    const long piece = there ? (long)pieces[row] : -1;    \
    const long first_edge = there ? starts[row] : 0, last_edge = there ? starts[row + 1] : 0;
#else
#define ROW                             \
    const long u = there ? row : 0;     \
    const long piece = -1;              \
    const long first_edge = starts[u], last_edge = there ? starts[u + 1] : first_edge;
#endif
#define EDGES                                                      \
    for (long e = first_edge + member; e < last_edge; e += TEAM) { \
        const long v = indices[e];
#define OFFSETS for (long e = piece < 0 ? first_edge + member : last_edge; e < last_edge; e += TEAM) {
#define FINISHES (piece < 0)
#endif
/* clang-format on */

#define VERTEX                                      \
    TEAM_MEMORY                                     \
    const long row = get_global_id(0) / TEAM;       \
    const int member = (int)get_local_id(0) % TEAM; \
    const bool there = row < n;                     \
    ROW

#if TEAM > 1
/* The sum over the team, the same for all its work items. Calls in turn use two memories: a work item writes to one
 * again only after the barrier of the next call, when all have read it. */
static inline real added_by_team(const real x, __local four *memory)
{
    const int own = (int)get_local_id(0);
    ((__local real *)memory)[own] = x;
    barrier(CLK_LOCAL_MEM_FENCE);
    const int first = own / TEAM * (TEAM / 4);
    four sum = memory[first];
    for (int i = 1; i < TEAM / 4; ++i) sum = ADDED(sum, memory[first + i]);
    return ADDED(ADDED(sum.s0, sum.s1), ADDED(sum.s2, sum.s3));
}
#endif

#ifdef HUBS
#define STORED(x, c)                                                                                                 \
    for (long i = there ? pieces[2 * row] + member : 0, last = there ? pieces[2 * row + 1] : 0; i < last; i += TEAM) \
        (x) = ADDED(x, sums[(c) * n_pieces + i]);
#define STORE_PIECE(x, c)
#elif defined(SPLIT)
#define STORED(x, c)
#define STORE_PIECE(x, c) \
    if (piece >= 0 && member == 0) sums[(c) * n_pieces + piece] = (x);
#else
#define STORED(x, c)
#define STORE_PIECE(x, c)
#endif
#define COLLECT(x, first, channels)                           \
    _Pragma("unroll") for (int i_ = 0; i_ < (channels); ++i_) \
    {                                                         \
        STORED((x)[i_], (first) + i_)                         \
        (x)[i_] = ADDED_BY_TEAM((x)[i_], ((first) + i_) & 1); \
        STORE_PIECE((x)[i_], (first) + i_)                    \
    }
#define ONE_WRITES \
    if (!there || member != 0 || !FINISHES) return;
#endif

#define NEIGHBOURS \
    EDGES          \
    EDGE_FACTORS

#endif
