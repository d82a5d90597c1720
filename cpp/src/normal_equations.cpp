#include "normal_equations.hpp"

#include <Eigen/Dense>
#include <stdexcept>

namespace plenocal {
namespace {

// Singular values of the column-scaled Jacobian below this fraction of the largest count as zero.
// They come as square roots of eigenvalues of J'J, which carry an error near
// size * epsilon ~ 1e-14 of the largest: values below 1e-7 cannot be distinguished from zero.
constexpr double kRankTolerance = 1e-7;

Group zero_group(int size) {
  return {Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
}

// Only the lower triangle, until `mirror`.
void add_row(const Eigen::VectorXd& row, double residual, Group* group) {
  group->information.selfadjointView<Eigen::Lower>().rankUpdate(row);
  group->gradient += residual * row;
}

void mirror(Eigen::MatrixXd* lower) {
  lower->triangularView<Eigen::StrictlyUpper>() = lower->transpose();
}

class Accumulator {
 public:
  Accumulator(int intrinsics, int frames, int types, int corners, int anchors)
      : by_kind_(frames,
                 {zero_group(intrinsics + Pose::kSize), zero_group(intrinsics + Pose::kSize)}),
        corners_(corners, zero_group(Pose::kSize)),
        frame_of_corner_(corners, 0),
        rho_(corners),
        anchors_(zero_group(intrinsics)) {
    equations_.intrinsics = intrinsics;
    const int size = intrinsics + Pose::kSize * frames;
    for (auto& information : equations_.information) information.setZero(size, size);
    equations_.gradient.setZero(size);
    equations_.patches.assign(kPatches, zero_group(intrinsics));
    equations_.corners.resize(frames);
    equations_.by_type_rho.setZero(size, types);
    equations_.anchors.setZero(anchors, intrinsics);
  }

  void add(const ceres::CRSMatrix& jacobian, int row, const RowOrigin& origin, double residual) {
    const int p = equations_.intrinsics;
    const bool of_feature = origin.kind == kUv || origin.kind == kRho;
    const int pose = of_feature ? equations_.pose(origin.group) : 0;
    Eigen::VectorXd local = Eigen::VectorXd::Zero(of_feature ? p + Pose::kSize : p);
    for (int i = jacobian.rows[row]; i < jacobian.rows[row + 1]; ++i) {
      const int column = jacobian.cols[i];
      local[column < p ? column : column - pose + p] = jacobian.values[i];
      equations_.gradient[column] += jacobian.values[i] * residual;
      if (origin.kind == kRho) {
        equations_.by_type_rho(column, origin.lens_type) += jacobian.values[i] / origin.std_dev;
      }
    }
    if (of_feature) {
      add_row(local, residual, &by_kind_[origin.group][origin.kind]);
      add_row(local.tail<Pose::kSize>(), residual, &corners_[origin.corner]);
      frame_of_corner_[origin.corner] = origin.group;
    } else {
      add_row(local, residual,
              origin.kind == kCenter ? &equations_.patches[origin.group] : &anchors_);
      if (origin.kind == kAnchor) equations_.anchors.row(origin.group) = local;
    }
    if (origin.kind == kRho) {
      rho_[origin.corner].sum += residual;
      ++rho_[origin.corner].count;
    } else {
      equations_.squares[origin.kind] += residual * residual;
      ++equations_.terms[origin.kind];
    }
    equations_.pixel_squares[origin.kind] += std::pow(residual * origin.std_dev, 2);
    ++equations_.count[origin.kind];
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
    }
    mirror(&anchors_.information);
    equations_.information[kAnchor].topLeftCorner(p, p) = anchors_.information;
    return std::move(equations_);
  }

 private:
  NormalEquations equations_;
  std::vector<std::array<Group, 2>> by_kind_;  // of frames: kUv, kRho
  std::vector<Group> corners_;
  std::vector<int> frame_of_corner_;
  struct Sum {
    double sum = 0.0;
    int count = 0;
  };
  std::vector<Sum> rho_;  // of corners
  Group anchors_;
};

struct Linearised {
  std::vector<double> residuals;
  ceres::CRSMatrix jacobian;
};

Linearised linearise(CalibrationProblem* calibration) {
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = calibration->free_blocks();
  Linearised result;
  if (!calibration->problem().Evaluate(options, nullptr, &result.residuals, nullptr,
                                       &result.jacobian)) {
    throw std::invalid_argument(
        "the model is not defined at this camera and these poses: a board point lies within the "
        "focal length of the main lens");
  }
  return result;
}

}  // namespace

GroupGradients group_gradients(CalibrationProblem* calibration) {
  const auto [residuals, jacobian] = linearise(calibration);
  const int p = static_cast<int>(calibration->free_intrinsics().size());
  const int frames = (jacobian.num_cols - p) / Pose::kSize;
  GroupGradients gradients;
  gradients.frames.assign(frames, Eigen::VectorXd::Zero(p + Pose::kSize));
  gradients.patches.assign(kPatches, Eigen::VectorXd::Zero(p));
  for (int row = 0; row < jacobian.num_rows; ++row) {
    const RowOrigin& origin = calibration->rows()[row];
    if (origin.kind == kAnchor) continue;
    const bool of_center = origin.kind == kCenter;
    Eigen::VectorXd& sum = (of_center ? gradients.patches : gradients.frames)[origin.group];
    const int pose = of_center ? 0 : Pose::kSize * origin.group;
    for (int i = jacobian.rows[row]; i < jacobian.rows[row + 1]; ++i) {
      const int column = jacobian.cols[i];
      sum[column < p ? column : column - pose] += jacobian.values[i] * residuals[row];
    }
  }
  return gradients;
}

NormalEquations normal_equations(CalibrationProblem* calibration) {
  const auto [residuals, jacobian] = linearise(calibration);
  const std::vector<RowOrigin>& rows = calibration->rows();
  int frames = 0, types = 0, corners = 0, anchors = 0;
  for (const RowOrigin& row : rows) {
    anchors += row.kind == kAnchor ? 1 : 0;
    if (row.corner < 0) continue;
    frames = std::max(frames, row.group + 1);
    types = std::max(types, row.lens_type + 1);
    corners = std::max(corners, row.corner + 1);
  }
  Accumulator sum(static_cast<int>(calibration->free_intrinsics().size()), frames, types, corners,
                  anchors);
  for (int row = 0; row < jacobian.num_rows; ++row) {
    sum.add(jacobian, row, rows[row], residuals[row]);
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
  // Eigenvalues come in ascending order.
  inverse = eigen.eigenvalues().unaryExpr([=](double v) { return v > threshold ? 1.0 / v : 0.0; });
  vectors = eigen.eigenvectors();
  basis = scale.asDiagonal() * vectors;
  coordinates = scale.cwiseInverse().asDiagonal() * vectors;
  rank = static_cast<int>((inverse.array() > 0.0).count());
}

}  // namespace plenocal
