// Steps of the spring lattice by hand in C++, on the lanes of heartcase.simulator.engine.shared.lanes. A peer, not ours.
//
// Windows, weights and the formula of a spring's force are those of heartcase/simulator/engine/cpu/springs.py. Other than
// there, lanes do not lie in banks, weights lie by lane alone, and each spring is worked out from both ends, at once:
// 1. A window of 8 lanes starts wherever a node does, not at a multiple of 8, so that fewer lanes are empty.
// 2. Lengths are in units of two cells. With U = D / 2 and o the rest vector in cells, e / 4 = o.U + U.U and
//    |d|^2 / 4 = e / 4 + L^2 / 4: fewer products for every spring. Two nodes on one spot are not provided for.
// 3. Of the two springs along a direction one takes an estimated root with one Newton step: divider and multipliers are
//    then busy for about as long. 16 lanes at a time are slower: more of them are empty, and every load is split.

#include <atomic>
#include <cmath>
#include <cstdint>
#include <omp.h>
#include <thread>
#if defined(__AVX__)
#include <immintrin.h>
#endif

#define INLINED inline __attribute__((always_inline))

namespace {

constexpr int WIDTH = 8;
typedef float Lanes __attribute__((vector_size(WIDTH * sizeof(float))));
typedef float Memory __attribute__((vector_size(WIDTH * sizeof(float)), aligned(sizeof(float)), may_alias));

// Half of the springs: from the lower node (i, j, k) to the higher; weights are stored in this order.
constexpr int DIRECTIONS[9][3] = {{1, 0, 0},  {-1, 1, 0}, {0, 1, 0}, {1, 1, 0}, {0, -1, 1},
                                  {-1, 0, 1}, {0, 0, 1},  {1, 0, 1}, {0, 1, 1}};

inline Lanes load(const float *from) { return (Lanes) * (const Memory *)from; }
inline void store(float *to, Lanes lanes) { *(Memory *)to = lanes; }

inline Lanes root(Lanes x) {
#if defined(__AVX__)
    return (Lanes)_mm256_sqrt_ps((__m256)x);
#else
    Lanes result;
    for (int lane = 0; lane < WIDTH; ++lane) result[lane] = std::sqrt(x[lane]);
    return result;
#endif
}

// length * sqrt(x)
inline Lanes estimated_root(Lanes x, float length) {
#if defined(__AVX512VL__)
    const Lanes inverse = (Lanes)_mm256_rsqrt14_ps((__m256)x);
#elif defined(__AVX__)
    const Lanes inverse = (Lanes)_mm256_rsqrt_ps((__m256)x);
#else
    return root(x) * length;
#endif
#if defined(__AVX__)
    const Lanes estimate = x * inverse;
    return estimate * (1.5f * length - 0.5f * length * (estimate * inverse));
#endif
}

struct Buffers {
    const float *now;
    float *later;
    float *velocity;
    const float *weight;
    const float *inverse_mass;
    int64_t lane_count;
    float step, keep, kick;
    const float *gravity;
};

// o.U of the spring ahead along a direction, or of the one behind.
template <int NUMBER> inline Lanes along(const Lanes *U, bool is_ahead) {
    Lanes sum = {};
    bool is_first = true;
    for (int axis = 0; axis < 3; ++axis) {
        const int o = is_ahead ? DIRECTIONS[NUMBER][axis] : -DIRECTIONS[NUMBER][axis];
        if (!o) continue;
        sum = is_first ? (o > 0 ? U[axis] : -U[axis]) : (o > 0 ? sum + U[axis] : sum - U[axis]);
        is_first = false;
    }
    return sum;
}

// Add the pulls of the two springs along one direction, ahead and behind.
template <int NUMBER> INLINED void add_pulls(const Buffers &b, const int32_t *rows, const Lanes *own, Lanes *force) {
    constexpr int i = DIRECTIONS[NUMBER][0], j = DIRECTIONS[NUMBER][1], k = DIRECTIONS[NUMBER][2];
    constexpr bool is_diagonal = i * i + j * j + k * k == 2;
    constexpr float length = is_diagonal ? 0.70710678f : 0.5f;
    const int64_t n = b.lane_count, here = rows[4];
    const int64_t at[2] = {rows[4 + 3 * k + j] + i, rows[4 - 3 * k - j] - i};
    const float *weight = b.weight + NUMBER * n;
    // Stage by stage for both, so that each has the other to work on while it waits.
    Lanes U[2][3], e[2], squared[2], pull[2], sum[2];
    for (int axis = 0; axis < 3; ++axis) {
        U[0][axis] = load(b.now + axis * n + at[0]) - own[axis];
        U[1][axis] = load(b.now + axis * n + at[1]) - own[axis];
    }
    for (int s = 0; s < 2; ++s) e[s] = U[s][0] * U[s][0] + along<NUMBER>(U[s], s == 0);
    for (int s = 0; s < 2; ++s) e[s] = U[s][1] * U[s][1] + e[s];
    for (int s = 0; s < 2; ++s) e[s] = U[s][2] * U[s][2] + e[s];
    for (int s = 0; s < 2; ++s) squared[s] = e[s] + length * length;
    for (int s = 0; s < 2; ++s) pull[s] = load(weight + (s ? at[s] : here)) * e[s];
    sum[1] = root(squared[1]);
    sum[0] = estimated_root(squared[0], length) + squared[0];
    sum[1] = sum[1] * length + squared[1];
    for (int s = 0; s < 2; ++s) pull[s] = pull[s] / sum[s];
    for (int s = 0; s < 2; ++s)
        for (int axis = 0; axis < 3; ++axis) {
            const int o = s ? -DIRECTIONS[NUMBER][axis] : DIRECTIONS[NUMBER][axis];
            force[axis] = pull[s] * (o ? U[s][axis] + 0.5f * (float)o : U[s][axis]) + force[axis];
        }
}

INLINED void step_of_window(const Buffers &b, const int32_t *rows) {
    const int64_t n = b.lane_count, here = rows[4];
    Lanes own[3], force[3] = {};
    for (int axis = 0; axis < 3; ++axis) own[axis] = load(b.now + axis * n + here);
    add_pulls<0>(b, rows, own, force);
    add_pulls<1>(b, rows, own, force);
    add_pulls<2>(b, rows, own, force);
    add_pulls<3>(b, rows, own, force);
    add_pulls<4>(b, rows, own, force);
    add_pulls<5>(b, rows, own, force);
    add_pulls<6>(b, rows, own, force);
    add_pulls<7>(b, rows, own, force);
    add_pulls<8>(b, rows, own, force);
    const Lanes inverse_mass = load(b.inverse_mass + here);
    for (int axis = 0; axis < 3; ++axis) {
        float *velocity = b.velocity + axis * n + here;
        const Lanes held = load(velocity);
        const Lanes moved = b.keep * held + b.kick * (force[axis] * inverse_mass + b.gravity[axis]);
        const Lanes next = inverse_mass > 0.0f ? moved : held;
        store(velocity, next);
        store(b.later + axis * n + here, own[axis] + b.step * next);
    }
}

// A meeting of all threads, a little quicker than OpenMP's barrier. Where other programs have the cores, a thread gives
// its turn away: OpenMP's waits it out, at a twentieth of the speed.
class Meeting {
  public:
    void wait(int threads) {
        const int round = round_.load(std::memory_order_relaxed);
        if (arrived_.fetch_add(1, std::memory_order_acq_rel) + 1 == threads) {
            arrived_.store(0, std::memory_order_relaxed);
            round_.store(round + 1, std::memory_order_release);
            return;
        }
        for (int turns = 0; round_.load(std::memory_order_acquire) == round; ++turns) {
            if (turns >= PATIENCE) std::this_thread::yield();
#if defined(__AVX__)
            else _mm_pause();
#endif
        }
    }

  private:
    static constexpr int PATIENCE = 2000;
    alignas(64) std::atomic<int> arrived_{0};
    alignas(64) std::atomic<int> round_{0};
};

} // namespace

// Take steps in place; returns the buffer that holds the displacement at the end.
//
// displacement (2, 3, lane_count) and velocity (3, lane_count) in units of two cells; weight (9, lane_count);
// inverse_mass (lane_count); rows (window_count, 9): first lanes of a window's nine rows; constants: step, keep, kick
// and the three components of gravity.
extern "C" int advance(float *displacement, float *velocity, const float *weight, const float *inverse_mass,
                       const int32_t *rows, int64_t window_count, int64_t lane_count, int current, int step_count,
                       const float *constants) {
    Meeting meeting;
#pragma omp parallel
    {
        const int64_t thread = omp_get_thread_num(), threads = omp_get_num_threads();
        const int64_t first = window_count * thread / threads, last = window_count * (thread + 1) / threads;
        for (int number = 0; number < step_count; ++number) {
            const int now = (current + number) % 2;
            const Buffers buffers = {displacement + now * 3 * lane_count,
                                     displacement + (1 - now) * 3 * lane_count,
                                     velocity,
                                     weight,
                                     inverse_mass,
                                     lane_count,
                                     constants[0],
                                     constants[1],
                                     constants[2],
                                     constants + 3};
            for (int64_t window = first; window < last; ++window) step_of_window(buffers, rows + 9 * window);
            meeting.wait(int(threads));
        }
    }
    return (current + step_count) % 2;
}
