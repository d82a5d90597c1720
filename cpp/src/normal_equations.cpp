#include "normal_equations.hpp"

#include <Eigen/Dense>
#include <cmath>
#include <utility>

#include "gram.hpp"
#include "parallel.hpp"

namespace plenocal {
namespace {

// Relative tolerance of the singular values of the column-scaled Jacobian: smaller ones count as
// zero. They are computed as square roots of eigenvalues of J'J, which have an error near
// size * epsilon ~ 1e-14 of the largest: values below 1e-7 cannot be distinguished from zero.
constexpr double kRankTolerance = 1e-7;

Group zero_group(int size) {
  return {Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
}

void mirror(Eigen::MatrixXd* lower) {
  lower->triangularView<Eigen::StrictlyUpper>() = lower->transpose();
}

// Number of blocks that all threads evaluate before their sums are added in their order.
constexpr int kBlocksAtOnce = 128;

using Linearised = LeastSquares::Linearised;

// Calls of_block(const Linearised&) for every block, on several threads, and then add(result) one
// after the other in their order, so that sums do not depend on the number of threads.
template <typename Result, typename OfBlock, typename Add>
void in_order(const LeastSquares& calibration, int threads, const OfBlock& of_block,
              const Add& add) {
  const int blocks = calibration.residual_blocks();
  std::vector<Result> results(std::min(blocks, kBlocksAtOnce));
  for (int first = 0; first < blocks; first += kBlocksAtOnce) {
    const int count = std::min(blocks - first, kBlocksAtOnce);
    in_parallel(count, threads, [&](int i) {
      thread_local Linearised block;
      calibration.linearise(first + i, &block);
      results[i] = of_block(block);
    });
    for (int i = 0; i < count; ++i) add(results[i]);
  }
}

// Calls f(begin, end) for consecutive rows of one group: a corner, a patch, or a prior.
template <typename F>
void for_runs(const RowOrigin* rows, int count, const F& f) {
  for (int begin = 0, end = 0; begin < count; begin = end) {
    const RowOrigin& first = rows[begin];
    while (end < count && rows[end].group == first.group && rows[end].corner == first.corner) {
      ++end;
    }
    f(begin, end);
  }
}

// Sums over the rows of one kind and group: products of J, r, and the changes of the observation by
// systematic errors.
struct Run {
  RowOrigin origin;  // origin of the first row
  int columns;       // number of columns of J
  std::vector<double> products;
  int width;  // number of columns of the products
  int count = 0;
  double sum = 0.0;            // sum of residuals
  double pixel_squares = 0.0;  // sum of squared residuals in px

  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  // Only the lower triangle is filled.
  auto all() const { return Eigen::Map<const RowMajor>(products.data(), width, width); }
  auto information() const { return all().topLeftCorner(columns, columns); }
  auto gradient() const { return all().row(columns).head(columns).transpose(); }
  double squares() const { return all()(columns, columns); }
  auto by_systematic(int k) const { return all().row(columns + 1 + k).head(columns).transpose(); }
};

// Returns the change of an observed number by a systematic error, over its standard deviation.
double moved(const SystematicError& error, const RowOrigin& row, bool is_u) {
  if (row.kind == kCenter) {
    if (error.centers.empty()) return 0.0;
    const Pixel<double>& by = error.centers[row.observation];
    return (is_u ? by.u : by.v) / row.std_dev;
  }
  const Feature<double>& by = error.features[row.observation];
  return (row.kind == kRho ? by.rho : is_u ? by.u : by.v) / row.std_dev;
}

Run sums_of_run(const Linearised& block, const RowOrigin* rows, int begin, int end,
                ResidualKind kind, const std::vector<SystematicError>& systematic) {
  const int columns = static_cast<int>(block.jacobian.cols());
  const int width = gram_width(columns + 1 + static_cast<int>(systematic.size()));
  Run run{rows[begin], columns, std::vector<double>(width * width), width};
  run.origin.kind = kind;
  thread_local std::vector<double> packed;
  packed.clear();
  for (int i = begin; i < end; ++i) {
    const RowOrigin& row = rows[i];
    if (row.kind != kind) continue;
    const double residual = block.residuals[i];
    const double* jacobian = block.jacobian.row(i).data();
    packed.insert(packed.end(), jacobian, jacobian + columns);
    packed.push_back(residual);
    // u comes before v.
    const bool is_u = i == 0 || rows[i - 1].observation != row.observation;
    for (const SystematicError& error : systematic) packed.push_back(moved(error, row, is_u));
    ++run.count;
    packed.resize(static_cast<std::size_t>(width) * run.count);
    run.sum += residual;
    run.pixel_squares += std::pow(residual * row.std_dev, 2);
  }
  gram_of(packed.data(), run.count, width, run.products.data());
  return run;
}

// Returns the sums of a block of features or centres.
std::vector<Run> sums_of(const Linearised& block, const RowOrigin* rows,
                         const std::vector<SystematicError>& systematic) {
  std::vector<Run> runs;
  for_runs(rows, static_cast<int>(block.residuals.size()), [&](int begin, int end) {
    const auto add = [&](ResidualKind kind) {
      runs.push_back(sums_of_run(block, rows, begin, end, kind, systematic));
    };
    add(rows[begin].kind);
    // Rows of u, v and rho alternate.
    if (rows[end - 1].kind == kRho) add(kRho);
  });
  return runs;
}

class Accumulator {
 public:
  Accumulator(int intrinsics, int frames, int corners, int priors,
              const std::vector<SystematicError>& systematic)
      : systematic_(systematic),
        by_kind_(frames,
                 {zero_group(intrinsics + Pose::kSize), zero_group(intrinsics + Pose::kSize)}),
        corners_(corners, zero_group(Pose::kSize)),
        frame_of_corner_(corners, 0),
        rho_(corners),
        priors_(zero_group(intrinsics)) {
    equations_.intrinsics = intrinsics;
    const int size = intrinsics + Pose::kSize * frames;
    for (auto& information : equations_.information) information.setZero(size, size);
    equations_.gradient.setZero(size);
    equations_.patches.assign(kPatches, zero_group(intrinsics));
    equations_.corners.resize(frames);
    equations_.by_systematic_observations.setZero(size,
                                                  static_cast<Eigen::Index>(systematic.size()));
    equations_.by_systematic_priors = equations_.by_systematic_observations;
    equations_.in_priors.setZero(size, priors);
    equations_.priors.setZero(priors, intrinsics);
  }

  void add(const Run& run) {
    const ResidualKind kind = run.origin.kind;
    const int p = equations_.intrinsics;
    if (run.origin.corner >= 0) {
      add_to(&by_kind_[run.origin.group][kind], run);
      Group& corner = corners_[run.origin.corner];
      corner.information += run.information().bottomRightCorner<Pose::kSize, Pose::kSize>();
      corner.gradient += run.gradient().tail<Pose::kSize>();
      frame_of_corner_[run.origin.corner] = run.origin.group;
    } else if (run.columns > 0) {
      add_to(&equations_.patches[run.origin.group], run);
    }
    for (int k = 0; k < static_cast<int>(systematic_.size()); ++k) {
      auto sum = equations_.by_systematic_observations.col(k);
      sum.head(p) += run.by_systematic(k).head(p);
      if (run.origin.corner < 0) continue;
      const int pose = equations_.pose(run.origin.group);
      sum.segment<Pose::kSize>(pose) += run.by_systematic(k).tail<Pose::kSize>();
    }
    if (kind == kRho) {
      rho_[run.origin.corner].sum += run.sum;
      rho_[run.origin.corner].count += run.count;
    } else {
      equations_.squares[kind] += run.squares();
      equations_.terms[kind] += run.count;
    }
    equations_.pixel_squares[kind] += run.pixel_squares;
    equations_.count[kind] += run.count;
  }

  // Adds the only row of a prior's block.
  void add_prior(const Linearised& block, const RowOrigin& row) {
    const double residual = block.residuals[0];
    equations_.squares[kPrior] += residual * residual;
    equations_.pixel_squares[kPrior] += std::pow(residual * row.std_dev, 2);
    ++equations_.terms[kPrior];
    ++equations_.count[kPrior];
    if (block.jacobian.cols() == 0) return;
    const Eigen::RowVectorXd jacobian = block.jacobian.row(0);
    priors_.information += jacobian.transpose() * jacobian;
    priors_.gradient += residual * jacobian.transpose();
    equations_.priors.row(row.group) = jacobian;
    double contained = 0.0;
    for (std::size_t k = 0; k < systematic_.size(); ++k) {
      const std::vector<double>& moved = systematic_[k].priors;
      if (moved.empty()) continue;
      const auto column = static_cast<Eigen::Index>(k);
      equations_.by_systematic_priors.col(column).head(equations_.intrinsics) +=
          moved[row.group] * jacobian.transpose();
      if (systematic_[k].in_priors) contained += moved[row.group] * moved[row.group];
    }
    equations_.in_priors.col(row.group).head(equations_.intrinsics) =
        std::sqrt(contained) * jacobian.transpose();
  }

  NormalEquations finish() {
    const int p = equations_.intrinsics;
    for (std::size_t frame = 0; frame < by_kind_.size(); ++frame) {
      const int pose = equations_.pose(static_cast<int>(frame));
      Group sum = zero_group(p + Pose::kSize);
      for (ResidualKind kind : {kUv, kRho}) {
        Group& group = by_kind_[frame][kind];
        mirror(&group.information);
        sum.information += group.information;
        sum.gradient += group.gradient;
        equations_.gradient.head(p) += group.gradient.head(p);
        equations_.gradient.segment<Pose::kSize>(pose) += group.gradient.tail<Pose::kSize>();
        Eigen::MatrixXd& all = equations_.information[kind];
        all.topLeftCorner(p, p) += group.information.topLeftCorner(p, p);
        all.block(pose, 0, Pose::kSize, p) = group.information.bottomLeftCorner(Pose::kSize, p);
        all.block(0, pose, p, Pose::kSize) = group.information.topRightCorner(p, Pose::kSize);
        all.block<Pose::kSize, Pose::kSize>(pose, pose) =
            group.information.bottomRightCorner<Pose::kSize, Pose::kSize>();
      }
      equations_.frames.push_back(std::move(sum));
    }
    for (std::size_t corner = 0; corner < corners_.size(); ++corner) {
      const auto& [sum, count] = rho_[corner];
      if (count > 0) {
        equations_.squares[kRho] += sum * sum / count;
        ++equations_.terms[kRho];
      }
      mirror(&corners_[corner].information);
      equations_.corners[frame_of_corner_[corner]].push_back(std::move(corners_[corner]));
    }
    for (Group& patch : equations_.patches) {
      mirror(&patch.information);
      equations_.information[kCenter].topLeftCorner(p, p) += patch.information;
      equations_.gradient.head(p) += patch.gradient;
    }
    equations_.information[kPrior].topLeftCorner(p, p) = priors_.information;
    equations_.gradient.head(p) += priors_.gradient;
    return std::move(equations_);
  }

 private:
  static void add_to(Group* group, const Run& run) {
    group->information += run.information();
    group->gradient += run.gradient();
  }

  const std::vector<SystematicError>& systematic_;
  NormalEquations equations_;
  std::vector<std::array<Group, 2>> by_kind_;  // by frame: kUv, kRho
  std::vector<Group> corners_;
  std::vector<int> frame_of_corner_;
  struct Sum {
    double sum = 0.0;
    int count = 0;
  };
  std::vector<Sum> rho_;  // by corner
  Group priors_;
};

}  // namespace

GroupGradients group_gradients(const LeastSquares& calibration, int threads) {
  const auto p = static_cast<Eigen::Index>(calibration.free_intrinsics().size());
  const std::vector<RowOrigin>& rows = calibration.rows();
  GroupGradients gradients;
  gradients.patches.assign(kPatches, Eigen::VectorXd::Zero(p));
  using OfGroup = std::pair<RowOrigin, Eigen::VectorXd>;
  in_order<std::vector<OfGroup>>(
      calibration, threads,
      [&](const Linearised& block) {
        std::vector<OfGroup> sums;
        const RowOrigin* of_block = &rows[block.first_row];
        const int n = static_cast<int>(block.residuals.size());
        const auto add = [&](int begin, int end) {
          sums.emplace_back(of_block[begin],
                            block.jacobian.middleRows(begin, end - begin).transpose() *
                                block.residuals.segment(begin, end - begin));
        };
        // A block of features contains only one frame.
        if (of_block->corner >= 0) {
          add(0, n);
        } else if (of_block->kind == kCenter) {
          for_runs(of_block, n, add);
        }
        return sums;
      },
      [&](const std::vector<OfGroup>& sums) {
        for (const auto& [origin, sum] : sums) {
          if (origin.corner < 0) {
            gradients.patches[origin.group] += sum;
            continue;
          }
          gradients.frames.resize(std::max<std::size_t>(gradients.frames.size(), origin.group + 1),
                                  Eigen::VectorXd::Zero(p + Pose::kSize));
          gradients.frames[origin.group] += sum;
        }
      });
  return gradients;
}

NormalEquations normal_equations(const LeastSquares& calibration,
                                 const std::vector<SystematicError>& systematic, int threads) {
  const std::vector<RowOrigin>& rows = calibration.rows();
  int frames = 0, corners = 0, priors = 0;
  for (const RowOrigin& row : rows) {
    priors += row.kind == kPrior ? 1 : 0;
    if (row.corner < 0) continue;
    frames = std::max(frames, row.group + 1);
    corners = std::max(corners, row.corner + 1);
  }
  Accumulator sum(static_cast<int>(calibration.free_intrinsics().size()), frames, corners, priors,
                  systematic);
  in_order<std::vector<Run>>(
      calibration, threads,
      [&](const Linearised& block) {
        const RowOrigin* of_block = &rows[block.first_row];
        return of_block->kind == kPrior ? std::vector<Run>{} : sums_of(block, of_block, systematic);
      },
      [&](const std::vector<Run>& runs) {
        for (const Run& run : runs) sum.add(run);
      });
  Linearised block;
  for (int index = 0; index < calibration.residual_blocks(); ++index) {
    if (rows[calibration.first_row(index)].kind != kPrior) continue;
    calibration.linearise(index, &block);
    sum.add_prior(block, rows[block.first_row]);
  }
  return sum.finish();
}

ScaledInverse::ScaledInverse(const Eigen::MatrixXd& information) {
  if (information.size() == 0) return;
  const Eigen::VectorXd scale =
      information.diagonal().unaryExpr([](double v) { return v > 0.0 ? 1.0 / std::sqrt(v) : 1.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.asDiagonal() * information *
                                                             scale.asDiagonal());
  const double threshold =
      kRankTolerance * kRankTolerance * eigen.eigenvalues().cwiseAbs().maxCoeff();
  // The eigenvalues are in ascending order.
  inverse = eigen.eigenvalues().unaryExpr([=](double v) { return v > threshold ? 1.0 / v : 0.0; });
  vectors = eigen.eigenvectors();
  basis = scale.asDiagonal() * vectors;
  coordinates = scale.cwiseInverse().asDiagonal() * vectors;
  rank = static_cast<int>((inverse.array() > 0.0).count());
}

}  // namespace plenocal
